"""Robot arms: their kinematics and limits, and the hand at their flange."""
