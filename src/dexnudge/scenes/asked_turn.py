"""Turns as people ask for them, by an angle: in place on what carries the object, or over the edge of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import SceneError
from dexnudge.finding import vector_text
from dexnudge.scenes.boxes import rectangle
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.motion import Turn, check_asked, turn_point
from dexnudge.scenes.resting import long_side_along_x
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import UPWARD, carrying_normal, touching_contacts, without_heading
from dexnudge.scenes.support_hull import hull_corners

EDGE_TOLERANCE = 5e-4  # [m] to which the outline of what carries the object is kept
SAID_FROM = 0.1  # [deg] by which a motion must be turned for it to be said
UP = np.array([0.0, 0.0, 1.0])


def check_heading(
    motion: Any, *, turn_deg: float | None, tip_deg: float | None, about: Any, slides: float | None
) -> bool:
    """As `check_asked`, in surroundings of one's own, where an object that just turns needs no motion, and has none."""
    asked = check_asked(turn_deg=turn_deg, tip_deg=tip_deg, about=about)
    if motion is None and (turn_deg is None or slides):
        why = "`tip_deg`" if tip_deg is not None else f"`motion_length` {slides:g}" if asked and slides else "a slide"
        raise SceneError(f"{why} needs `motion` too: a direction (dx, dy, dz) in the world; add it")
    if motion is not None and turn_deg is not None and slides is None:
        raise SceneError(
            "`motion` is given with `turn_deg`, after which nothing slides; add `motion_length`, or leave `motion` out"
        )
    return asked


def with_turn(
    scene: Scene,
    *,
    turn_deg: float | None = None,
    tip_deg: float | None = None,
    about: Sequence[float] | Float[np.ndarray, "3"] | None = None,
    motion_length: float | None = None,
) -> Scene:
    """Return the scene with a turn before its slide, as asked for in degrees; the same scene where none is.

    turn_deg: about the normal of what carries the object, from -180 to 180, counter-clockwise from above where positive.
    tip_deg: over the edge of what carries it, toward the motion. about: a point of the turn's axis [m, world]; the centre of
    mass unless given, or where that is blocked the corner of the rectangle around it about which it turns farthest.
    motion_length: of the slide after the turn [m]; that of the scene unless given.

    Raises:
        SceneError: an invalid angle or point, both turns at once, or a tip of an object that nothing carries, or by a motion
            that leads into or off what carries it.
    """
    if not check_asked(turn_deg=turn_deg, tip_deg=tip_deg, about=about):
        return scene
    length = scene.motion_length if motion_length is None else motion_length
    if tip_deg is not None:
        return _tipped(scene, np.radians(float(tip_deg)), length)
    assert turn_deg is not None
    return _turned(scene, np.radians(float(turn_deg)), about, length)


def _turned(scene: Scene, angle: float, about: Any, motion_length: float) -> Scene:
    """Return the scene with a turn by `angle` [rad] on its support, about a point or where that is free farthest."""
    below = [support for support in scene.supports if support.side == "below"]
    axis = np.sign(angle) * (below[0].normal if below else UP)
    best, farthest = scene, (-1.0, 0.0)
    for point in _pivots(scene) if about is None else [turn_point(about)]:
        made = replace(scene, turn=Turn(abs(angle), axis, point), motion_length=motion_length)
        if about is not None or scene.misplaced or (way := free_way(made)).whole:
            return made
        if (way.angle, way.slid) > farthest:
            best, farthest = made, (way.angle, way.slid)
    return best


def _pivots(scene: Scene) -> Iterator[Float[np.ndarray, "3"]]:
    """Yield the centre of mass, and the corners of the smallest rectangle around the object, seen from above [m, world]."""
    centre = scene.centre_of_mass
    yield centre
    seen = np.asarray(scene.object_in_world().convex_hull.vertices)[:, :2]
    axes = long_side_along_x(seen)[:2, :2]
    low, high = (seen @ axes.T).min(axis=0), (seen @ axes.T).max(axis=0)
    for corner in rectangle((low + high) / 2, tuple(high - low), 0.0):
        yield np.append(corner @ axes, centre[2])


def over_foremost(scene: Scene, angle: float, motion_length: float) -> Scene:
    """Return the scene with a tip by `angle` [rad] toward its motion, over the foremost line on which the object stands.

    motion_length: of the slide after it [m]. Raises SceneError where nothing carries the object.
    """
    normal, points = _carrying(scene)
    axis = np.cross(normal, scene.motion)
    turn = Turn(angle, axis, points[int(np.argmax(points @ np.cross(axis, normal)))])
    return replace(scene, turn=turn, motion_length=motion_length)


def _carrying(scene: Scene) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "n 3"]]:
    """Return the normal of what carries the object and where it does [m, world], the surroundings' own edges included."""
    touching = touching_contacts(replace(scene, turn=Turn(1.0, UP, scene.centre_of_mass)))
    points = touching.points[touching.normals[:, 2] > UPWARD]
    if not len(points):
        raise SceneError("nothing carries the object; expected a surface below it that it tips over; mend its pose")
    return carrying_normal(touching), points


def _tipped(scene: Scene, angle: float, motion_length: float) -> Scene:
    """Return the scene with a turn by `angle` [rad] over the edge of the support toward which the motion leads."""
    scene.validate()
    normal, points = _carrying(scene)
    if wrong := without_heading(scene.motion, normal):
        raise SceneError(f"{wrong}; give a `motion` toward the edge to tip over")
    outward = _outward(points[hull_corners(points, normal, tolerance=EDGE_TOLERANCE)], normal, scene.motion)
    off = float(np.degrees(np.arccos(np.clip(outward @ scene.motion, -1.0, 1.0))))
    if off < SAID_FROM:
        return over_foremost(scene, angle, motion_length)
    mesh = scene.environment_mesh.copy()
    said = f"the motion was turned by {off:.1f} deg to {vector_text(outward, digits=2)}, across the edge that is tipped over"
    mesh.metadata.update(
        scene.environment_mesh.metadata, notes=[*scene.environment_mesh.metadata.get("notes", ()), said]
    )
    parameters = {"motion_given": scene.motion} | scene.parameters
    return over_foremost(
        replace(scene, environment_mesh=mesh, motion=outward, parameters=parameters), angle, motion_length
    )


def _outward(
    corners: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "3"], motion: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the outward normal, on their plane, of that edge of a convex outline which is nearest to a direction.

    Of a line one of the two across it; of one point the direction itself.
    """
    outward = np.cross(np.roll(corners, -1, axis=0) - corners, normal)
    lengths = np.linalg.norm(outward, axis=1, keepdims=True)
    level = motion - (motion @ normal) * normal
    if not lengths.any():
        return level / np.linalg.norm(level)
    outward /= lengths
    outward *= np.where(((corners - corners.mean(axis=0)) * outward).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    both = np.concatenate([outward, -outward]) if len(corners) == 2 else outward
    return both[int(np.argmax(both @ level))]
