"""Planning: how the object must move to become graspable, and how the hand gets to where it touches it."""
