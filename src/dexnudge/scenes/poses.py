"""Poses and directions as people and programs write them, checked: matrices, quaternions, JSON files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import LONGEST_QUOTE, SceneError, check_path, quote
from dexnudge.geometry.rigid import real_numbers, rigid_transform, unit_vector
from dexnudge.jobs.json_files import read_json

POSE_KEY, POSITION_KEY, QUATERNION_KEY = "T_world_object", "position", "quaternion_wxyz"
QUATERNION_TOLERANCE = 1e-3  # on the norm; three decimals are what people type


def unit_motion(value: Any) -> Float[np.ndarray, "3"]:
    """Return `value` as a unit vector; SceneError when it is zero, not finite, or not three real numbers."""
    try:
        motion = real_numbers(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise SceneError(f"motion is not a vector of numbers; expected three ({error})") from error
    if motion.shape != (3,):
        raise SceneError(f"motion has shape {motion.shape}; expected three numbers (dx, dy, dz)")
    largest = float(np.abs(motion).max())
    if not 0 < largest < np.inf:
        raise SceneError(
            f"motion is ({motion[0]:g}, {motion[1]:g}, {motion[2]:g}); expected a finite direction that is not zero, "
            "such as (1, 0, 0)"
        )
    return unit_vector(motion)


def load_pose(path: str | Path, key: str = POSE_KEY, argument: str = "object_pose") -> Float[np.ndarray, "4 4"]:
    """Read a pose from a JSON file: the 4 x 4 list, alone or named `key`, or "position" [m] and "quaternion_wxyz".

    Raises:
        SceneError: missing, malformed, or not a rigid pose.
    """
    check_path(argument, path, SceneError)
    path = Path(path)
    content = read_json(path)
    if (
        isinstance(content, list) and all(isinstance(row, list) for row in content) and len(content) > 1
    ):  # the bare matrix
        content = {key: content}
    if not isinstance(content, dict):
        raise SceneError(f"{path}: holds a JSON {type(content).__name__}; expected an object with named values")
    if key in content and (POSITION_KEY in content or QUATERNION_KEY in content):
        raise SceneError(
            f"{path}: holds the pose twice, as {key!r} and as {POSITION_KEY!r} or {QUATERNION_KEY!r}; expected one "
            "of them; remove the other"
        )
    if key in content:
        return rigid_transform(content[key], f"{path}: {key}")
    if POSITION_KEY not in content or QUATERNION_KEY not in content:
        raise SceneError(
            f"{path}: holds {quote(list(content))[1:-1] or 'nothing'}; expected {key!r} (4 x 4), or "
            f"{POSITION_KEY!r} (x, y, z in metres) and {QUATERNION_KEY!r}"
        )
    position = _vector(content[POSITION_KEY], 3, POSITION_KEY, path)
    quaternion = _vector(content[QUATERNION_KEY], 4, QUATERNION_KEY, path)
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1) <= QUATERNION_TOLERANCE:
        raise SceneError(f"{path}: {QUATERNION_KEY} has norm {norm:.4g}; expected 1, in the order w, x, y, z")
    pose = np.eye(4)
    pose[:3, :3] = trimesh.transformations.quaternion_matrix(quaternion / norm)[:3, :3]
    pose[:3, 3] = position
    return rigid_transform(pose, key)


def _vector(value: Any, size: int, key: str, path: Path) -> np.ndarray:
    try:
        vector = real_numbers(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f"{path}: {key} is {repr(value)[:LONGEST_QUOTE]}; expected {size} numbers") from error
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise SceneError(f"{path}: {key} is {repr(value)[:LONGEST_QUOTE]}; expected {size} finite numbers")
    return vector
