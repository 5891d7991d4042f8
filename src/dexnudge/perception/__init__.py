"""Depth images and point clouds as surroundings, and objects that are known only from their masks."""
