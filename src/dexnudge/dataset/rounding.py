"""Numbers that a dataset stores: multiples of powers of two, so that what is judged is what is stored.

A multiple of 2**-k is exact in float32 and float64 as long as it is below 2**(24-k), so nothing changes between the
verification, the file and a reader; its trailing mantissa bits are zero, and Parquet files become a good deal smaller.
"""

import numpy as np
from jaxtyping import Float

TRANSLATION_STEP = 2.0**-15  # [m] 31 micrometres: a thirtieth of the penetration that is allowed
ROTATION_STEP = 2.0**-15  # rounded columns stay orthonormal to 6e-5, within the 1e-4 that a configuration may be off
JOINT_STEP = 2.0**-13  # [rad] 0.007 degrees; half of it lies within the 1e-4 rad that a limit may be off
MARGIN_STEP = 2.0**-10  # force margins have no unit; half of what a solver on another machine may differ by
POINT_STEP = 2.0**-16  # [m] 15 micrometres, on surfaces
NORMAL_STEP = 2.0**-10  # a twentieth of a degree

_ROTATION, _JOINTS = slice(3, 9), slice(9, None)  # places in q = [translation (3) | rotation columns (6) | joints]


def round_configuration(q: Float[np.ndarray, "*batch dimension"]) -> Float[np.ndarray, "*batch dimension"]:
    """The nearest configurations that a dataset can store: call it before they are verified.

    q: [root translation (3) [m] | first two columns of the root rotation (6) | joint angles [rad]]. Rounding keeps the
    order of two joints, so a coupling that held still holds; a joint at its limit leaves it by at most 6.1e-5 rad.
    Rounded twice is rounded once. The columns are no longer exactly orthonormal: every reader makes them so again.
    """
    rounded = round_to(q, TRANSLATION_STEP)
    rounded[..., _ROTATION] = round_to(q[..., _ROTATION], ROTATION_STEP)
    rounded[..., _JOINTS] = round_to(q[..., _JOINTS], JOINT_STEP)
    return rounded


def floor_margin(margin: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """The greatest force margins that a dataset can store and that do not exceed the true ones; 1 and -1 stay."""
    return np.floor(margin / MARGIN_STEP) * MARGIN_STEP


def round_cloud(cloud: Float[np.ndarray, "point 6"]) -> Float[np.ndarray, "point 6"]:
    """The nearest points [m] and normals that a dataset can store; normals are unit vectors to within 0.001."""
    return np.concatenate([round_to(cloud[:, :3], POINT_STEP), round_to(cloud[:, 3:], NORMAL_STEP)], axis=1)


def round_to(values: Float[np.ndarray, "*batch"], step: float) -> Float[np.ndarray, "*batch"]:
    """The nearest multiples of `step`, halves to even."""
    return np.rint(values / step) * step
