"""Where a hand's base and fingers are told to be at every step: along a planned way, along a line, or where they are."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.simulation.push_model import TIMESTEP

Configurations = Float[np.ndarray, "step coordinates"]  # q (world) at every step


def along_way(times: Float[np.ndarray, " sample"], q: Float[np.ndarray, "sample coordinates"]) -> Configurations:
    """q (world) at `times` [s, increasing], one row per step; empty for a single sample.

    Between samples everything but the rotation is linear; the rotation turns about one axis.
    """
    if len(times) < 2:
        return np.zeros((0, q.shape[1]))
    clock = times[0] + TIMESTEP * np.arange(1, round((times[-1] - times[0]) / TIMESTEP) + 1)
    clock = np.minimum(clock, times[-1])
    steps = np.stack([np.interp(clock, times, column) for column in q.T], axis=1)
    steps[:, 3:ROOT_COORDINATES] = _six(Slerp(times, rotations(q))(clock))
    return steps


def along_line(q: Float[np.ndarray, " coordinates"], way: Float[np.ndarray, " 3"], *, speed: float) -> Configurations:
    """The base moves by `way` [m, world] as (1 - cos) / 2, at `speed` [m/s] in the middle; the fingers are told to stay."""
    length = float(np.linalg.norm(way))
    count = int(np.ceil(np.pi / 2 * length / speed / TIMESTEP))
    steps = np.tile(q, (count, 1))
    steps[:, :3] += 0.5 * (1 - np.cos(np.pi * np.arange(1, count + 1) / max(count, 1)))[:, None] * way
    return steps


def bending(
    q: Float[np.ndarray, " coordinates"], angles: Float[np.ndarray, " joint"], *, speed: float
) -> Configurations:
    """The joints go evenly to `angles` [rad], the fastest at `speed` [rad/s]; the base is told to stay."""
    change = angles - q[ROOT_COORDINATES:]
    count = int(np.ceil(np.abs(change).max() / speed / TIMESTEP))
    steps = np.tile(q, (count, 1))
    steps[:, ROOT_COORDINATES:] += np.arange(1, count + 1)[:, None] / max(count, 1) * change
    return steps


def waiting(q: Float[np.ndarray, " coordinates"], *, seconds: float) -> Configurations:
    """The hand is told to stay."""
    return np.tile(q, (round(seconds / TIMESTEP), 1))


def palm_velocity(q: Configurations, before: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "step 6"]:
    """Of the palm's target, linear [m/s] then angular [rad/s], in the axes of the palm's target.

    before: q of the step before the first.
    """
    rotation = rotations(np.concatenate([before[None], q]))
    turned = (rotation[1:] * rotation[:-1].inv()).as_rotvec()
    linear = np.diff(np.concatenate([before[None], q])[:, :3], axis=0)
    own = rotation[1:].inv()
    return np.concatenate([own.apply(linear), own.apply(turned)], axis=1) / TIMESTEP


def rotations(q: Configurations) -> Rotation:
    """Rotation of each row's palm; the two stored columns are made orthonormal."""
    x = q[:, 3:6] / np.linalg.norm(q[:, 3:6], axis=1, keepdims=True)
    y = q[:, 6:9] - (q[:, 6:9] * x).sum(axis=1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=2))


def _six(rotation: Rotation) -> Float[np.ndarray, "step 6"]:
    matrices = rotation.as_matrix()
    return np.concatenate([matrices[:, :, 0], matrices[:, :, 1]], axis=1)
