"""Poses and directions as people and programs write them, checked: matrices, quaternions, JSON files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import LONGEST_QUOTE, SceneError, check_path

POSE_KEY, POSITION_KEY, QUATERNION_KEY = "T_world_object", "position", "quaternion_wxyz"
QUATERNION_TOLERANCE = 1e-3  # on the norm; three decimals are what people type
RIGID_TOLERANCE = 1e-5  # on R^T R - I; poses typed by hand carry six digits
ROUNDED_TOLERANCE = 1e-3  # on R^T R - I; up to here the nearest rotation is taken: it carries three or four decimals
SMALLEST_SQUARED = 1e-100  # components below it or above its inverse are scaled before they are squared
FARTHEST = 1e3  # [m] a pose farther from the origin than this is no pose of an object in a room


def rigid_transform(value: Any) -> Float[np.ndarray, "4 4"]:
    """Return `value` as a float64 rigid transform; a rotation that was rounded becomes the nearest exact one.

    Raises:
        SceneError: not a 4 x 4 matrix of finite numbers, or |R^T R - I| > 1e-3.
    """
    try:
        pose = _real_numbers(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise SceneError(f"T_world_object is not a matrix of numbers; expected 4 x 4 ({error})") from error
    if pose.shape != (4, 4):
        raise SceneError(f"T_world_object has shape {pose.shape}; expected (4, 4)")
    if not np.isfinite(pose).all():
        raise SceneError("T_world_object holds NaN or infinity; expected finite numbers")
    if np.abs(pose[:3, 3]).max() > FARTHEST:
        raise SceneError(f"T_world_object is {pose[:3, 3].tolist()} m from the origin; expected at most {FARTHEST:g} m")
    rotation, last_row = pose[:3, :3], pose[3]
    skew = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    determinant = float(np.linalg.det(rotation))
    if skew > ROUNDED_TOLERANCE or determinant < 0 or (last_row != [0, 0, 0, 1]).any():
        remedy = "scale the mesh, not the pose"
        if skew <= ROUNDED_TOLERANCE and last_row[3] == 1 and last_row[:3].any() and not pose[:3, 3].any():
            remedy = "transposed? the translation belongs into the last column"
        elif skew <= ROUNDED_TOLERANCE and determinant < 0:
            remedy = "it mirrors: was it written in a left-handed frame?"
        raise SceneError(
            f"T_world_object is not a rigid transform: |R^T R - I| = {skew:.2g}, det R = {determinant:.3g}, "
            f"last row {last_row.tolist()}; expected a rotation (tolerance {ROUNDED_TOLERANCE:g}, det 1) and last row "
            f"[0, 0, 0, 1]; {remedy}"
        )
    if skew > RIGID_TOLERANCE:
        left, _, right = np.linalg.svd(rotation)
        pose[:3, :3] = left @ right
    return pose


def unit_motion(value: Any) -> Float[np.ndarray, "3"]:
    """Return `value` as a unit vector; SceneError when it is zero, not finite, or not three real numbers."""
    try:
        motion = _real_numbers(value)
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
    if not SMALLEST_SQUARED < largest < 1 / SMALLEST_SQUARED:
        motion = motion / largest
    return motion / float(np.linalg.norm(motion))


def _real_numbers(value: Any) -> np.ndarray:
    """Return a float64 array; TypeError for complex numbers, whose imaginary part NumPy would drop."""
    if np.iscomplexobj(np.asarray(value)):
        raise TypeError("they are complex")
    return np.array(value, dtype=np.float64)


def load_pose(path: str | Path) -> Float[np.ndarray, "4 4"]:
    """Read T_world_object from a JSON file: "T_world_object" (4 x 4), or "position" [m] and "quaternion_wxyz".

    Raises:
        SceneError: missing, malformed, or not a rigid pose.
    """
    check_path("object_pose", path, SceneError)
    path = Path(path)
    content = read_json_object(path)
    if POSE_KEY in content and (POSITION_KEY in content or QUATERNION_KEY in content):
        raise SceneError(
            f"{path}: holds the pose twice, as {POSE_KEY!r} and as {POSITION_KEY!r} or {QUATERNION_KEY!r}; expected one "
            "of them; remove the other"
        )
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
    if not abs(norm - 1) <= QUATERNION_TOLERANCE:
        raise SceneError(f"{path}: {QUATERNION_KEY} has norm {norm:.4g}; expected 1, in the order w, x, y, z")
    pose = np.eye(4)
    pose[:3, :3] = trimesh.transformations.quaternion_matrix(quaternion / norm)[:3, :3]
    pose[:3, 3] = position
    return rigid_transform(pose)


def read_json_object(path: Path) -> dict[str, Any]:
    """Read the JSON object in a file.

    Raises:
        SceneError: missing, unreadable, malformed, not an object, or with NaN or infinity in it.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except (FileNotFoundError, IsADirectoryError) as error:
        raise SceneError(f"{path}: no such file; expected a JSON file") from error
    except (ValueError, OSError, RecursionError) as error:
        raise SceneError(f"{path}: cannot be read as JSON ({error}); the file is truncated or damaged") from error
    if not isinstance(content, dict):
        raise SceneError(f"{path}: holds a JSON {type(content).__name__}; expected an object with named values")
    return content


def _vector(value: Any, size: int, key: str, path: Path) -> np.ndarray:
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f"{path}: {key} is {repr(value)[:LONGEST_QUOTE]}; expected {size} numbers") from error
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise SceneError(f"{path}: {key} is {repr(value)[:LONGEST_QUOTE]}; expected {size} finite numbers")
    return vector


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a JSON number")
