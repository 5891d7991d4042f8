"""Hands: kinematic tree, limits and geometry, from facts, URDF or MJCF."""

from dexnudge.hands.hand import Hand, LinkPoints

__all__ = ["Hand", "LinkPoints"]
