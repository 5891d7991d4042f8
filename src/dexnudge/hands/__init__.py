"""Hands: kinematic tree, limits and geometry, from facts, URDF or MJCF."""
