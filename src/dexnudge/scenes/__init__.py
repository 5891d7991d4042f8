"""Scenes: an object, its surroundings and the motion that it should make."""

from dexnudge.scenes.families import SCENE_FAMILIES, build_scene
from dexnudge.scenes.scene import Scene

__all__ = ["SCENE_FAMILIES", "Scene", "build_scene"]
