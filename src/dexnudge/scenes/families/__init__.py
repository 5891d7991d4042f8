"""The table of scene families. A new family is one file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import UnknownNameError, check_kind, check_seed, did_you_mean
from dexnudge.objects.sets import object_mesh
from dexnudge.plugins import call_plugin, plugin_names, usable_plugins
from dexnudge.scenes.asked_turn import with_turn
from dexnudge.scenes.families.book import book
from dexnudge.scenes.families.clutter import clutter
from dexnudge.scenes.families.drawer import drawer
from dexnudge.scenes.families.layers import layers, slot
from dexnudge.scenes.families.shelf import deep, shelf
from dexnudge.scenes.families.table import corner, edge, ramp, stack, table, turn
from dexnudge.scenes.motion import check_asked
from dexnudge.scenes.scene import Scene, check_physics

SceneFamily = Callable[[trimesh.Trimesh, np.random.Generator], Scene]

SCENE_FAMILIES: dict[str, SceneFamily] = {
    "table": table,
    "layers": layers,
    "shelf": shelf,
    "slot": slot,
    "deep": deep,
    "corner": corner,
    "clutter": clutter,
    "turn": turn,
    "book": book,
    "edge": edge,
    "drawer": drawer,  # nothing is ever tuned on this one and those below
    "ramp": ramp,
    "stack": stack,
}


def scene_families() -> tuple[str, ...]:
    """Return the names that `build_scene` knows: the built-in ones, and what installed packages bring."""
    return (*SCENE_FAMILIES, *usable_plugins("scene"))


def build_scene(
    family: str,
    object: str | Path | trimesh.Trimesh,  # noqa: A002 - the public name
    *,
    seed: int = 0,
    turn_deg: float | None = None,
    tip_deg: float | None = None,
    about: Sequence[float] | Float[np.ndarray, "3"] | None = None,
    **physics: Any,
) -> Scene:
    """Draw a scene of a family for an object.

    Args:
        family: one of `scene_families()`.
        object: name of a built-in object, a mesh file [m], or a mesh in metres, object frame.
        seed: seed of the scene's random parameters. The same family, object and seed give the same scene.
        turn_deg: angle by which the object should turn before the motion of the family, as in `Scene.from_files`.
        tip_deg: angle by which it should tip before that, as in `Scene.from_files`.
        about: point of the turn's axis [m, world], as in `Scene.from_files`.
        physics: motion_length [m], mass [kg], friction_hand, friction_environment, max_normal_force [N]; defaults
            as in `Scene`.

    Raises:
        UnknownNameError: no such family; the message lists those that exist.
        MeshError: the object's file cannot be used.
        InputError: an object that is neither name, file nor mesh, or a seed that is no integer from 0 to 2^63 - 1.
        SceneError: the object does not fit, a physical number is out of its domain, or the turn is invalid.
    """
    check_kind("family", family, str, "'table'")
    names = tuple(SCENE_FAMILIES) if family in SCENE_FAMILIES else (*SCENE_FAMILIES, *plugin_names("scene"))
    if family not in names:
        raise UnknownNameError(
            f"unknown scene {family!r}{did_you_mean(family, names)}; expected one of {', '.join(names)}, "
            "or your own surroundings through `environment`"
        )
    check_physics(physics)
    asked = check_asked(turn_deg=turn_deg, tip_deg=tip_deg, about=about)
    slide = physics.pop("motion_length", None) if asked else None
    check_seed(seed)
    mesh, generator = object_mesh(object), np.random.default_rng(seed)
    if family in SCENE_FAMILIES:
        scene = SCENE_FAMILIES[family](mesh, generator)
    else:
        scene = call_plugin("scene", family, Scene, mesh, generator)
    scene = replace(scene, seed=seed, **physics)
    return with_turn(scene, turn_deg=turn_deg, tip_deg=tip_deg, about=about, motion_length=slide)
