"""Rigid transforms as people and programs write them, checked."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import SceneError

RIGID_TOLERANCE = 1e-5  # on R^T R - I; poses typed by hand carry six digits
ROUNDED_TOLERANCE = 1e-3  # on R^T R - I; up to here the nearest rotation is taken: it carries three or four decimals
ROUGHLY_ROUNDED = 0.03  # on R^T R - I; two decimals leave less
LAST_ROW = "; add the last row [0, 0, 0, 1]"
SMALLEST_SQUARED = 1e-100  # components below it or above its inverse are scaled before they are squared
FARTHEST = 1e3  # [m] a pose farther from the origin than this is no pose of an object in a room


def rigid_transform(
    value: Any, name: str = "T_world_object", *, unscaled: str = "scale the mesh, not the pose"
) -> Float[np.ndarray, "4 4"]:
    """Return `value` as a float64 rigid transform; a rotation that was rounded becomes the nearest exact one.

    `name` is what messages call it, `unscaled` how to mend a transform that scales.

    Raises:
        SceneError: not a 4 x 4 matrix of finite numbers, or |R^T R - I| > 1e-3.
    """
    try:
        pose = real_numbers(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise SceneError(f"{name} is not a matrix of numbers; expected 4 x 4 ({error})") from error
    if pose.shape != (4, 4):
        raise SceneError(f"{name} has shape {pose.shape}; expected (4, 4){LAST_ROW if pose.shape == (3, 4) else ''}")
    if not np.isfinite(pose).all():
        raise SceneError(f"{name} holds NaN or infinity; expected finite numbers")
    if np.abs(pose[:3, 3]).max() > FARTHEST:
        raise SceneError(f"{name} is {pose[:3, 3].tolist()} m from the origin; expected at most {FARTHEST:g} m")
    rotation, last_row = pose[:3, :3], pose[3]
    skew = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    determinant = float(np.linalg.det(rotation))
    if skew > ROUNDED_TOLERANCE or determinant < 0 or (last_row != [0, 0, 0, 1]).any():
        remedy = unscaled
        if skew <= ROUNDED_TOLERANCE and last_row[3] == 1 and last_row[:3].any() and not pose[:3, 3].any():
            remedy = "transposed? the translation belongs into the last column"
        elif skew <= ROUNDED_TOLERANCE and determinant < 0:
            remedy = "it mirrors: was it written in a left-handed frame?"
        elif ROUNDED_TOLERANCE < skew < ROUGHLY_ROUNDED:
            remedy = "was it rounded? write its numbers with four decimals or more"
        raise SceneError(
            f"{name} is not a rigid transform: |R^T R - I| = {skew:.2g}, det R = {determinant:.3g}, "
            f"last row {last_row.tolist()}; expected a rotation (tolerance {ROUNDED_TOLERANCE:g}, det 1) and last row "
            f"[0, 0, 0, 1]; {remedy}"
        )
    if skew > RIGID_TOLERANCE:
        left, _, right = np.linalg.svd(rotation)
        pose[:3, :3] = left @ right
    return pose


def real_numbers(value: Any) -> np.ndarray:
    """Return a float64 array; TypeError for texts, truth values, and complex numbers, whose imaginary part would be lost."""
    if np.iscomplexobj(np.asarray(value)):
        raise TypeError("they are complex")
    for each in np.asarray(value, dtype=object).flat:
        if isinstance(each, str | bytes | bool | np.bool_):
            raise TypeError(f"{each!r} is none")
    return np.array(value, dtype=np.float64)


def unit_vector(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return a finite vector that is not zero at unit length, however long or short it is."""
    largest = float(np.abs(vector).max())
    if not SMALLEST_SQUARED < largest < 1 / SMALLEST_SQUARED:
        vector = vector / largest
    return vector / float(np.linalg.norm(vector))
