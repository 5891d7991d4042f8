"""`book`: upright in a row, like a book, to be tipped forward and pulled out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import SceneError
from dexnudge.scenes.asked_turn import over_foremost
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.resting import resting_pose
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import UPWARD, support_contacts

GAP = (0.0003, 0.0008)  # [m] from the object to the neighbour on each side: near enough to hold it
HEIGHT = (0.70, 0.95)  # of the neighbours, of the object's
DEPTH = (0.85, 1.15)  # the same of their depth
THICKNESS = (0.015, 0.040)  # [m] of the neighbours
FLUSH = 0.003  # [m] by which their fronts are off the object's
FRONT = (0.10, 0.14)  # [m] of the board before the object
BOARD = (0.40, 0.80, 0.02)  # [m] depth, width, thickness; its top is z = 0
ANGLE = np.radians([20.0, 30.0])  # of the tip
PULL = (0.06, 0.08)  # [m] of the slide after it
STEADY = 0.002  # [m] from the centre of mass to the foremost, and to the hindmost, point on which it stands
SPARE = np.radians(1.0)  # of a tip, before the angle at which its foot would enter the board
FORWARD = np.array([1.0, 0.0, 0.0])


def book(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Longest side upright, middle side along +x, thin side between two neighbours; tipped by 20 to 30 deg, then pulled out.

    It tips about the foremost line on which it stands. Nothing is above it. One that would fall over by itself stands on its
    other end, and one with a round foot tips as far as that lets it, if that is 20 deg.

    Raises:
        SceneError: it stands on neither.
    """
    front_down, turned = bool(generator.integers(2)), bool(generator.integers(2))
    front, angle, pull = generator.uniform(*FRONT), generator.uniform(*ANGLE), generator.uniform(*PULL)
    beside = [[generator.uniform(*each) for each in (HEIGHT, DEPTH, GAP, THICKNESS, (-FLUSH, FLUSH))] for _ in range(2)]
    ends = (
        _row(mesh, _upright(mesh, front_down=down, turned=turned), front, beside)
        for down in (front_down, not front_down)
    )
    blocked: Scene | None = None
    for scene in filter(_stands, ends):
        tipped = _tipped(scene, angle, pull)
        if free_way(tipped).whole:
            return tipped
        blocked = blocked or tipped
    if blocked is not None:
        return blocked
    raise SceneError(
        "the object stands upright on neither end: its centre of mass is not above what it stands on; expected one that a "
        "row of books holds; choose another scene"
    )


def _tipped(scene: Scene, angle: float, pull: float) -> Scene:
    """Return the scene with its motion; a round foot would enter the board at some angle, before which the tip ends then."""
    tipped = over_foremost(scene, angle, pull)
    free = free_way(tipped)
    if not free.whole and free.angle - SPARE >= ANGLE[0]:
        angle = free.angle - SPARE
        tipped = over_foremost(scene, angle, pull)
    tipped.parameters["tip_degrees"] = float(np.degrees(angle))
    return tipped


def _row(
    mesh: trimesh.Trimesh, pose: Float[np.ndarray, "4 4"], front: float, beside: Sequence[Sequence[float]]
) -> Scene:
    """Return the object on a board between two neighbours, each of height, depth, gap, thickness and front (see above)."""
    placed = np.asarray(mesh.vertices) @ pose[:3, :3].T + pose[:3, 3]
    depth, _, height = (float(side) for side in np.ptp(placed, axis=0))
    parts = [box((front - BOARD[0], -BOARD[1] / 2, -BOARD[2]), (front, BOARD[1] / 2, 0.0))]
    neighbours = []
    for side, (high, far, gap, thick, flush) in zip((-1.0, 1.0), beside, strict=True):
        tall, deep = high * height, far * depth
        near = placed[placed[:, 2] <= tall]
        inner = side * (float((side * near[:, 1]).max()) + gap)
        outer = inner + side * thick
        parts.append(box((flush - deep, min(inner, outer), 0.0), (flush, max(inner, outer), tall)))
        neighbours.append({"height": tall, "depth": deep, "thickness": thick, "gap": gap, "front": flush})
    parameters = {"height": height, "front": front, "neighbours": neighbours}
    return Scene(mesh, joined(parts), pose, FORWARD, name="book", parameters=parameters)


def _stands(scene: Scene) -> bool:
    """Return whether the object falls neither forward nor backward; to the sides its neighbours hold it."""
    contacts, centre = support_contacts(scene), scene.centre_of_mass
    ahead = contacts.points[contacts.normals[:, 2] > UPWARD, 0] - centre[0]
    return bool(ahead.min(initial=0.0) <= -STEADY and ahead.max(initial=0.0) >= STEADY)


def _upright(mesh: trimesh.Trimesh, *, front_down: bool, turned: bool) -> np.ndarray:
    """Return the pose with the lowest point on z = 0, the front at x = 0 and the middle of the thickness at y = 0."""
    flat = resting_pose(mesh)
    size = np.ptp(np.asarray(mesh.vertices) @ flat[:3, :3].T, axis=0)
    _, middle, long = np.argsort(size, kind="stable")
    axes = np.eye(3)
    up, forward = axes[long] * (-1.0 if front_down else 1.0), axes[middle] * (-1.0 if turned else 1.0)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([forward, np.cross(up, forward), up]) @ flat[:3, :3]
    placed = np.asarray(mesh.vertices) @ pose[:3, :3].T
    low, high = placed.min(axis=0), placed.max(axis=0)
    pose[:3, 3] = -high[0], -(low[1] + high[1]) / 2, -low[2]
    return pose
