"""Between the samples of a trajectory: the quintic through position, velocity and acceleration at both ends.

So does ros2_control's JointTrajectoryController interpolate a trajectory that brings all three.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from dexnudge.trajectories.plan import JointTrajectory

# Hermite's quintic on [0, 1]: coefficients of x^3, x^4, x^5 by p1 - p0 - v0 - a0/2, v1 - v0 - a0, a1 - a0.
HERMITE = np.array([[10.0, -4.0, 0.5], [-15.0, 7.0, -1.0], [6.0, -3.0, 0.5]])


class JointState(NamedTuple):
    """n joints at t times: position [rad], velocity [rad/s], acceleration [rad/s^2], jerk [rad/s^3]."""

    position: Float[np.ndarray, "t n"]
    velocity: Float[np.ndarray, "t n"]
    acceleration: Float[np.ndarray, "t n"]
    jerk: Float[np.ndarray, "t n"]


def at(trajectory: JointTrajectory, time: Float[np.ndarray, " t"]) -> JointState:
    """Return where the joints are and how they move at times [s].

    Before the first and after the last sample the joints rest there. The jerk jumps at samples: there it is the
    jerk of the piece that begins, and at the end of the trajectory of the last one.
    """
    knots = trajectory.time
    if len(knots) == 1:
        still = np.zeros((len(time), trajectory.position.shape[1]))
        return JointState(trajectory.position[0] + still, still, still, still)
    piece = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 2)
    length = np.diff(knots)[piece]
    share = (time - knots[piece]) / length
    inside = at_shares(trajectory, piece, np.clip(share, 0.0, 1.0))
    outside = ((time < knots[0]) | (time > knots[-1]))[:, None]
    return JointState(inside.position, *(np.where(outside, 0.0, values) for values in inside[1:]))


def at_shares(trajectory: JointTrajectory, piece: np.ndarray, share: Float[np.ndarray, " t"]) -> JointState:
    """Return the state in pieces between samples, at shares of their durations, 0 to 1; sides of a sample differ."""
    h = np.diff(trajectory.time)[piece][:, None]
    x = share[:, None]
    p0, p1 = trajectory.position[piece], trajectory.position[piece + 1]
    v0, v1 = trajectory.velocity[piece] * h, trajectory.velocity[piece + 1] * h
    a0, a1 = trajectory.acceleration[piece] * h**2, trajectory.acceleration[piece + 1] * h**2
    ends = np.stack([p1 - p0 - v0 - a0 / 2, v1 - v0 - a0, a1 - a0])
    c3, c4, c5 = np.einsum("cd,dtn->ctn", HERMITE, ends)
    return JointState(
        p0 + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5)))),
        (v0 + x * (a0 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / h,
        (a0 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / h**2,
        (6 * c3 + x * (24 * c4 + x * 60 * c5)) / h**3,
    )
