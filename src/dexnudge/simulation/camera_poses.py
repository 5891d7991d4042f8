"""Where a robot's depth camera would stand to see an object and what is around it."""

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.surface_lattice import surface_lattice
from dexnudge.scenes.boxes import joined
from dexnudge.scenes.scene import Scene

AZIMUTHS = 12  # around the object
ELEVATIONS = (15.0, 30.0, 45.0, 60.0)  # [deg] above the horizon
DISTANCES = (0.55, 0.7)  # [m] from the object
AROUND = 0.15  # [m] of the surroundings around the object that are to be seen
SPACING = 0.01  # [m] between the points that are to be seen
SEEN_AT = np.cos(np.radians(75.0))  # least cosine between a surface's normal and the way to the camera
OBJECT_SHARE = 2 / 3  # of the object's points that the best pose sees: what every chosen one sees at least
FARTHEST = 4.0  # [m] no ray is followed beyond
OFF_SURFACE = 1e-4  # [m] before a surface, where rays from it start: they must not meet it again
ROOM = 0.1  # [m] that a camera keeps from everything


def camera_poses(scene: Scene, *, num: int = 3) -> list[Float[np.ndarray, "4 4"]]:
    """Return `num` poses T_world_camera, 0.55 or 0.7 m from the object, that together see most of it and around it.

    Taken one after another: the one that sees most points of the object, and of the surroundings that face it, which no
    earlier one has seen (a greedy next-best view); so in front of a shelf, and around a table. None is taken that sees much
    less of the object than another one does. Fewer where there is no more room.
    """
    body = scene.object_in_world()
    points, normals, own = _points_to_see(body, scene.environment_mesh)
    rays, centre = Rays(joined([body, scene.environment_mesh])), body.bounds.mean(axis=0)
    candidates, seen = [], []
    for position in _positions(centre, scene.motion):
        to_camera = position - points
        distance = np.linalg.norm(to_camera, axis=1)
        directions = to_camera / distance[:, None]
        free, _ = rays.first_hits(points + OFF_SURFACE * normals, directions, reach=FARTHEST)
        visible = (free >= distance) & (np.einsum("px,px->p", normals, directions) > SEEN_AT)
        around, _ = rays.first_hits(np.tile(position, (6, 1)), np.concatenate([np.eye(3), -np.eye(3)]), reach=FARTHEST)
        if around.min() >= ROOM:
            candidates.append(looking_at(centre, position))
            seen.append(visible)
    of_object = [int(visible[:own].sum()) for visible in seen]
    enough = OBJECT_SHARE * max(of_object, default=0)
    candidates = [pose for pose, number in zip(candidates, of_object, strict=True) if number >= enough]
    seen = [visible for visible, number in zip(seen, of_object, strict=True) if number >= enough]
    chosen: list[int] = []
    missing = np.ones(len(points), dtype=bool)
    while len(chosen) < min(num, len(candidates)):
        gain = [int((visible & missing).sum()) if index not in chosen else -1 for index, visible in enumerate(seen)]
        chosen.append(int(np.argmax(gain)))
        missing &= ~seen[chosen[-1]]
    return [candidates[index] for index in chosen]


def looking_at(target: Float[np.ndarray, "3"], position: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return T_world_camera of an upright camera at `position` [m] that looks at `target` [m], not from straight above."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return pose


def _positions(centre: Float[np.ndarray, "3"], motion: Float[np.ndarray, "3"]) -> Sequence[Float[np.ndarray, "3"]]:
    """Places around the object, the first in the direction of its motion."""
    azimuths = np.arctan2(motion[1], motion[0]) + 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    turned = np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)
    return [
        centre + distance * np.array([*(np.cos(angle) * direction), np.sin(angle)])
        for distance in DISTANCES
        for angle in np.radians(ELEVATIONS)
        for direction in turned
    ]


def _points_to_see(
    body: trimesh.Trimesh, surroundings: trimesh.Trimesh
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], int]:
    """Points with normals, evenly spread over the object and over what faces it; the number of those on the object."""
    own, face = surface_lattice(np.asarray(body.triangles), spacing=SPACING)
    centre, (low, high) = body.bounds.mean(axis=0), body.bounds + np.array([[-AROUND], [AROUND]])
    corners, others = np.asarray(surroundings.triangles), np.asarray(surroundings.face_normals)
    near = np.flatnonzero(((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1))
    around, other_face = surface_lattice(corners[near], spacing=SPACING)
    normals = others[near][other_face]
    facing = np.einsum("px,px->p", normals, centre - around) > 0
    kept = facing & ((around >= low) & (around <= high)).all(axis=1)
    return np.concatenate([own, around[kept]]), np.concatenate([body.face_normals[face], normals[kept]]), len(own)
