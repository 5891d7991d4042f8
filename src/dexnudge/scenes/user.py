"""A scene in the user's own surroundings: an environment mesh, a pose file and a motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import SceneError
from dexnudge.geometry.meshes import load_environment
from dexnudge.scenes.files import read_json_object
from dexnudge.scenes.scene import Scene, rigid_transform, unit_motion

POSE_KEY, POSITION_KEY, QUATERNION_KEY = "T_world_object", "position", "quaternion_wxyz"
QUATERNION_TOLERANCE = 1e-3  # on the norm; three decimals are what people type


def user_scene(
    mesh: trimesh.Trimesh,
    *,
    environment: str | Path | trimesh.Trimesh,
    object_pose: str | Path | Float[np.ndarray, "4 4"],
    motion: Sequence[float] | Sequence[int] | Float[np.ndarray, "3"],
    units: str = "m",
    **physics: Any,
) -> Scene:
    """The scene of an object in given surroundings, checked.

    Args:
        mesh: of the object, metres, object frame.
        environment: mesh file in `units`, world frame, z up; or a mesh in metres.
        object_pose: JSON file with "T_world_object" (4 x 4), or "position" [m] and "quaternion_wxyz"; or the matrix.
            Metres, whatever `units` says.
        motion: direction (3,) in the world that the object should slide in; normalised.
        units: of the environment's file.
        physics: motion_length [m], mass [kg], friction_hand, friction_environment, max_normal_force [N].

    Raises:
        SceneError: a malformed pose, a zero motion, a number out of its domain, or an environment that already
            penetrates the object by more than 1 mm.
        MeshError: the environment's file cannot be used.
    """
    surroundings = environment
    if not isinstance(surroundings, trimesh.Trimesh):
        surroundings = load_environment(surroundings, units=units)
    pose = load_pose(object_pose) if isinstance(object_pose, str | Path) else rigid_transform(object_pose)
    scene = Scene(mesh, surroundings, pose, unit_motion(motion), name="user", **physics)
    scene.validate()
    return scene


def load_pose(path: str | Path) -> Float[np.ndarray, "4 4"]:
    """T_world_object from a JSON file; see `user_scene`.

    Raises:
        SceneError: missing, malformed, or not a rigid pose.
    """
    path = Path(path)
    content = read_json_object(path)
    if POSE_KEY in content:
        return rigid_transform(content[POSE_KEY])
    if POSITION_KEY not in content or QUATERNION_KEY not in content:
        raise SceneError(
            f"{path}: holds {', '.join(map(repr, content)) or 'nothing'}; expected {POSE_KEY!r} (4 x 4), or "
            f"{POSITION_KEY!r} (x, y, z in metres) and {QUATERNION_KEY!r}"
        )
    position = _vector(content[POSITION_KEY], 3, POSITION_KEY, path)
    quaternion = _vector(content[QUATERNION_KEY], 4, QUATERNION_KEY, path)
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > QUATERNION_TOLERANCE:
        raise SceneError(f"{path}: {QUATERNION_KEY} has norm {norm:.4g}; expected 1, in the order w, x, y, z")
    pose = np.eye(4)
    pose[:3, :3] = trimesh.transformations.quaternion_matrix(quaternion / norm)[:3, :3]
    pose[:3, 3] = position
    return pose


def _vector(value: Any, size: int, key: str, path: Path) -> np.ndarray:
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{path}: {key} is {value!r}; expected {size} numbers") from error
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise SceneError(f"{path}: {key} is {value!r}; expected {size} finite numbers")
    return vector
