"""The object carried along its motion: what it would run into first, by rays on a slide and by distances on a turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from dexnudge.geometry.exact_distance import ExactDistance, Rays
from dexnudge.geometry.surface_lattice import Boxes, distinct_rows, faces_near, lattice_in_boxes, surface_lattice
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.motion import Motion, Turn
from dexnudge.scenes.placement import INITIAL_PENETRATION_LIMIT, surroundings_distance
from dexnudge.scenes.scene import Scene

SPACING = 0.003  # [m] between the points that look for obstacles
LEADING = -0.1  # cosine with the motion from which a surface can run into something
LIFT = 0.0015  # [m] by which the object is raised off its support to find obstacles; a lower step is none
LIFT_OF_NOISE = 2.0  # the same in standard deviations of noisy surfaces: nearly all of their bumps are lower
INSET = 0.0003  # [m] by which its points are drawn inward: a wall that it grazes is no obstacle
TOUCHED_INSET = INITIAL_PENETRATION_LIMIT + INSET  # [m] the same beside and under what it touches, and may overlap
LARGEST_INSET = 1 / 3  # of the object's size across the motion: something of it must be left
ACROSS = 0.5  # cosine with a direction from which a contact's normal counts as along it
HEAD_START = 0.0015  # [m] before obstacles, from which rays look back: what overlaps the object is seen as well
COLUMN = 0.004  # [m] half the width of the column in which an obstacle's height is measured
TALLEST = 1.0  # [m] to which it is followed


@dataclass(frozen=True)
class Obstacle:
    """What stands in the way: after how many metres, and where [m, world]."""

    way: float
    place: Float[np.ndarray, "3"]


class Sweep:
    """The object of a scene, carried along straight ways past its surroundings.

    Attributes:
        mesh: the object in the world.
        points, normals: of its whole surface, drawn inward a little [m, world]; a place may be there more than once.
        lift: by how much it is raised off its support: 1.5 mm, or twice the noise of its surroundings [m].
    """

    def __init__(self, scene: Scene) -> None:
        self.mesh = scene.object_in_world()
        self.lift = max(LIFT, LIFT_OF_NOISE * scene.surface_noise)
        points, face = surface_lattice(np.asarray(self.mesh.triangles, dtype=np.float64), spacing=SPACING)
        self._face_normals = np.asarray(self.mesh.face_normals, dtype=np.float64)
        self.normals = self._face_normals[face]
        self.points = points - INSET * self.normals
        self._noisy = scene.surface_noise > 0
        self._object, self._surroundings = Rays(self.mesh), scene.environment_mesh

    def first_obstacle(
        self,
        direction: Float[np.ndarray, "3"],
        *,
        carrying: Float[np.ndarray, "3"],
        touching: Float[np.ndarray, "contact 3"],
        reach: float,
    ) -> Obstacle | None:
        """Return what the object meets first within `reach` [m] along a unit `direction`; None for a free way.

        The object is lifted by `lift` along the normal `carrying` of its support (zeros where nothing carries it). Rays from
        its points forward, and from the surroundings' points in the swept volume backward, so that neither a thin post nor
        a small corner slips between the rays of the other. What it only grazes beside or above is no obstacle: one that
        would not be met by the object 0.3 mm lower, or 0.3 mm to its other side; 1.3 mm, or `lift` among noisy surfaces, on
        sides where it touches something (normals `touching`, from the surroundings to the object).
        """
        start = self.lift * carrying
        low, high = self.points.min(axis=0) + start, self.points.max(axis=0) + start
        low, high = np.minimum(low, low + reach * direction), np.maximum(high, high + reach * direction)
        triangles = triangles_in_box(self._surroundings, low, high)
        if not len(triangles):
            return None
        box = Boxes((low + high)[None] / 2, np.eye(3)[None], (high - low)[None] / 2)
        places = lattice_in_boxes(triangles, box, spacing=SPACING)[0]
        leading = self.points[self.normals @ direction > LEADING] + start
        near = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)
        ahead, face = Rays(near).first_hits(leading, direction[None], reach=reach)
        met = face >= 0
        places = np.concatenate([places, leading[met] + ahead[met, None] * direction])
        way = self._back(places - start, direction, reach)  # infinite where it does not meet them
        for aside in self._asides(direction, carrying, touching):
            found = np.flatnonzero(way < np.inf)
            missed = self._back(places[found] - start - aside, direction, reach + self.lift) == np.inf
            way[found[missed]] = np.inf
        if not (way < np.inf).any():
            return None
        first = int(way.argmin())
        return Obstacle(float(way[first]), places[first])

    def height(self, place: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> float:
        """Return how far what stands at `place` reaches along the unit vector `up` from there [m]: as far as it is one."""
        axes = trimesh.geometry.align_vectors([0, 0, 1], up)[:3, :3].T
        half = np.array([COLUMN, COLUMN, TALLEST / 2])
        centre = place + TALLEST / 2 * up
        extent = half @ np.abs(axes)
        triangles = triangles_in_box(self._surroundings, centre - extent, centre + extent)
        column = Boxes(centre[None], axes[None], half[None])
        heights = np.sort((lattice_in_boxes(triangles, column, spacing=SPACING)[0] - place) @ up)
        heights = np.concatenate([[0.0], heights[heights > 0]])
        gaps = np.flatnonzero(np.diff(heights) > 2 * SPACING)
        return float(heights[gaps[0] if len(gaps) else -1])

    def _back(
        self, points: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "3"], reach: float
    ) -> Float[np.ndarray, " n"]:
        """Return how far the object, where it is, can go until it meets each point [m]; infinite beyond `reach`."""
        ahead = points + HEAD_START * direction
        way, face = self._object.first_hits(ahead, -direction[None], reach=reach + HEAD_START)
        way[(face < 0) | (self._face_normals[face] @ direction <= 0)] = np.inf  # or from within, out of its back
        return np.maximum(way - HEAD_START, 0.0)

    def _asides(
        self,
        direction: Float[np.ndarray, "3"],
        carrying: Float[np.ndarray, "3"],
        touching: Float[np.ndarray, "contact 3"],
    ) -> list[Float[np.ndarray, "3"]]:
        """Return displacements of the lifted object; what is not met in each of them is no obstacle."""
        if not carrying.any():
            return []
        side = np.cross(carrying, direction)
        if np.linalg.norm(side) < ACROSS:  # straight off its support
            return []
        side /= np.linalg.norm(side)
        asides = []
        for away in (-carrying, side, -side):
            touched = bool((touching @ away > ACROSS).any())
            inset = max(TOUCHED_INSET, self.lift if self._noisy else 0.0) if touched else INSET
            drop = self.lift if away @ carrying < -ACROSS else 0.0  # first back down, then below its support
            left = LARGEST_INSET * (float(np.ptp(self.points @ away)) - drop)
            if left > 0:
                asides.append((drop + min(inset, left)) * away)
        return asides


@cached_per_instance
def sweep_of(scene: Scene) -> Sweep:
    """Return the scene's object, ready to be carried; made once per scene."""
    return Sweep(scene)


def triangles_in_box(
    mesh: trimesh.Trimesh, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "face 3 3"]:
    """Return the triangles whose bounds meet an axis-aligned box [m]."""
    near = faces_near(mesh, np.stack([low, high]))
    return np.asarray(np.asarray(mesh.vertices)[np.asarray(mesh.faces)[near]], dtype=np.float64)


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
