"""The object carried along its motion: what it would meet first, by rays on a slide and by distances on a turn."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import Boxes, distinct_rows, lattice_in_boxes
from dexnudge.scenes.motion import Motion, Turn
from dexnudge.scenes.placement import INITIAL_PENETRATION_LIMIT, surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.sweep import INSET, LIFT_OF_NOISE, SPACING, Obstacle, sweep_of, triangles_in_box

FLAT = 1e-6  # [m] along an axis, below which a triangle is flat across it
APART = 1e-3  # [m] points of the object that are nearer to each other are looked at once


def first_met(
    scene: Scene, carrying: Float[np.ndarray, "3"], touching: Float[np.ndarray, "contact 3"], *, reach: float
) -> Obstacle | None:
    """Return what the object meets first within `reach` [m] of the stage that its motion begins with; None where it is free.

    carrying: normal of what carries it, zeros where nothing does. touching: normals of all that it touches.
    """
    if scene.turn is None:
        return sweep_of(scene).first_obstacle(scene.motion, carrying=carrying, touching=touching, reach=reach)
    return _met_in_turn(scene, scene.turn, scene.object_motion, reach)


def _met_in_turn(scene: Scene, turn: Turn, motion: Motion, reach: float) -> Obstacle | None:
    """Return where a point of the object is first too deep in its surroundings, or a point of theirs in it.

    Too deep is 1 mm, twice the noise of the surfaces, or what some point is at the start. No point moves faster than 1, so
    one that is d away goes on by d and 1 mm more at once: places at which something may be met are at most 1 mm apart.
    """
    sweep, surroundings = sweep_of(scene), surroundings_distance(scene.environment_mesh)
    own = sweep.points + INSET * sweep.normals
    own = own[distinct_rows(np.round(own / APART))[0]]
    low, high = scene.way_bounds()
    box = Boxes((low + high)[None] / 2, np.eye(3)[None], (high - low)[None] / 2)
    triangles = triangles_in_box(scene.environment_mesh, low, high)
    theirs = lattice_in_boxes(triangles, box, spacing=SPACING)[0]
    depth = max(INITIAL_PENETRATION_LIMIT, LIFT_OF_NOISE * scene.surface_noise)
    height = theirs @ turn.axis  # which a turn does not change
    theirs = theirs[(height > (own @ turn.axis).min() + depth) & (height < (own @ turn.axis).max() - depth)]
    own = own[_may_cross(triangles @ turn.axis, own @ turn.axis, depth)]
    found: list[Obstacle] = []
    for points, other, sign in ((own, surroundings, 1.0), (theirs, ExactDistance(sweep.mesh), -1.0)):
        way = np.zeros(len(points))
        left = np.arange(len(points))
        limit = None
        while len(left):
            angle = sign * way[left] / motion.radius
            places = Rotation.from_rotvec(angle[:, None] * turn.axis).apply(points[left] - turn.point) + turn.point
            distance = other(places).distance
            limit = max(depth, -float(distance.min())) if limit is None else limit
            met = distance < -limit
            if met.any():
                first = int(np.where(met, way[left], np.inf).argmin())
                place = places[first] if sign > 0 else points[left[first]]
                found.append(Obstacle(float(way[left[first]]), place))
                reach = min(reach, found[-1].way)
            way[left] += np.maximum(distance, 0.0) + depth
            left = left[~met & (way[left] < reach)]
    return min(found, key=lambda each: each.way, default=None)


def _may_cross(
    triangles: Float[np.ndarray, "face 3"], points: Float[np.ndarray, " n"], depth: float
) -> Bool[np.ndarray, " n"]:
    """Return which points may come to be in something, by heights along the axis of a turn, corners' and points' [m].

    What is flat across the axis is only grazed.
    """
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    steep = high - low > FLAT
    begun = np.searchsorted(np.sort(low[steep] - depth), points, side="right")
    return begun > np.searchsorted(np.sort(high[steep] + depth), points, side="left")
