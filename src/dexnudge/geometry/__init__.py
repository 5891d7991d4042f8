"""Meshes, points on them, signed distances and rotations."""
