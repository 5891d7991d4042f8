"""What is costly to make from a scene, made on first use and kept as long as the scene is."""

from collections.abc import Callable
from typing import TypeVar

from dexnudge.made_once import made_once
from dexnudge.scenes.scene import Scene

Made = TypeVar("Made")


def per_scene(make: Callable[[Scene], Made]) -> Callable[[Scene], Made]:
    """Decorates a function of a scene; scenes are told apart by identity, and never changed."""
    return made_once(make)
