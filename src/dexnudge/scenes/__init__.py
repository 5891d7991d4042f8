"""Scenes: an object, its surroundings and the motion that it should make."""
