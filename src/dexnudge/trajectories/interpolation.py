"""Between the samples of a trajectory: the quintic through position, velocity and acceleration at both ends, and its limits.

So does ros2_control's JointTrajectoryController interpolate a trajectory that brings all three.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PPoly

from dexnudge.arms.arm import JointLimits
from dexnudge.trajectories.plan import JointTrajectory

# Powers 0 to 5 of x on [0, 1] by p0, v0, a0, p1, v1, a1, where velocities are by x and accelerations by x twice.
QUINTIC = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0],
        [-10.0, -6.0, -1.5, 10.0, -4.0, 0.5],
        [15.0, 8.0, 1.5, -15.0, 7.0, -1.0],
        [-6.0, -3.0, -0.5, 6.0, -3.0, 0.5],
    ]
)


class JointState(NamedTuple):
    """n joints at t times: position [rad], velocity [rad/s], acceleration [rad/s^2], jerk [rad/s^3]."""

    position: Float[np.ndarray, "t n"]
    velocity: Float[np.ndarray, "t n"]
    acceleration: Float[np.ndarray, "t n"]
    jerk: Float[np.ndarray, "t n"]


def at(trajectory: JointTrajectory, time: Float[np.ndarray, " t"]) -> JointState:
    """Return where the joints are and how they move at times [s].

    Before the first sample and after the last the joints rest where these are. At a sample, where the jerk jumps, it is
    that of the piece which begins there; at the last, of the piece which ends there.
    """
    inside, quintics = time.clip(trajectory.time[0], trajectory.time[-1]), _quintics(trajectory)
    moving = (inside == time)[:, None]
    return JointState(quintics(inside), *(np.where(moving, quintics(inside, order), 0.0) for order in (1, 2, 3)))


def densely(trajectory: JointTrajectory, interval: float) -> tuple[Float[np.ndarray, " t"], JointState]:
    """Return times [s] at most an interval apart, and the states there; at inner samples on both sides of the jump."""
    knots, pieces, quintics = trajectory.time, np.diff(trajectory.time), _quintics(trajectory)
    steps = np.maximum(np.ceil(pieces / interval - 1e-6), 1).astype(int)
    piece = np.repeat(np.arange(len(steps)), steps + 1)
    step = np.arange(len(piece)) - np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
    time = knots[piece] + pieces[piece] * step / steps[piece]
    time[step == steps[piece]] = np.nextafter(knots[1:], -np.inf)  # of the piece that ends there
    return time, JointState(*(quintics(time, order) for order in range(4)))


def _quintics(trajectory: JointTrajectory) -> PPoly:
    h = np.diff(trajectory.time)[:, None]
    position, velocity, acceleration = trajectory.position, trajectory.velocity, trajectory.acceleration
    starts = [position[:-1], velocity[:-1] * h, acceleration[:-1] * h**2]
    ends = [position[1:], velocity[1:] * h, acceleration[1:] * h**2]
    by_share = QUINTIC @ np.stack([*starts, *ends], axis=1)  # (piece, power, joint), lowest power first
    return PPoly((by_share / h[..., None] ** np.arange(6)[:, None])[:, ::-1].swapaxes(0, 1), trajectory.time)


CHECK_INTERVAL = 0.001  # [s] controllers of arms run at 1 kHz
TOLERANCE = 1e-6  # of a limit: rounding, as at a joint that rests on its limit


@dataclass(frozen=True)
class Exceeded:
    """A limit that a joint exceeds most at `time` [s]; share: of the limit, above 1; limit: position, velocity, …."""

    joint: str
    limit: str
    share: float
    time: float

    def __str__(self) -> str:
        return f"joint '{self.joint}' uses {self.share:.1%} of its {self.limit} limit at {self.time:.3f} s"


@dataclass(frozen=True)
class LimitsUsed:
    """Greatest share of each joint's limits that a trajectory uses.

    position: 0 in the middle of the joint's range, 1 at its ends. velocity, acceleration, jerk: of the greatest
    magnitude. exceeded: what is above 1.
    """

    position: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    acceleration: Float[np.ndarray, " n"]
    jerk: Float[np.ndarray, " n"]
    exceeded: tuple[Exceeded, ...]


def limits_used(
    trajectory: JointTrajectory, limits: JointLimits, joint_names: Sequence[str] | None = None
) -> LimitsUsed:
    """Return how much of its limits a trajectory uses at every millisecond of the quintics between its samples.

    joint_names: what `exceeded` calls the joints; left out: their numbers from 1.
    """
    joints = trajectory.position.shape[1]
    names = joint_names or [str(number + 1) for number in range(joints)]
    time, state = densely(trajectory, CHECK_INTERVAL)
    used = {
        "position": _share_of_range(state.position, limits),
        "velocity": np.abs(state.velocity) / limits.velocity,
        "acceleration": np.abs(state.acceleration) / limits.acceleration,
        "jerk": np.abs(state.jerk) / limits.jerk,
    }
    exceeded = []
    for limit, shares in used.items():
        worst = shares.argmax(axis=0)
        for joint, row in enumerate(worst):
            if shares[row, joint] > 1 + TOLERANCE:
                exceeded.append(Exceeded(names[joint], limit, float(shares[row, joint]), float(time[row])))
    return LimitsUsed(**{limit: shares.max(axis=0) for limit, shares in used.items()}, exceeded=tuple(exceeded))


def _share_of_range(position: Float[np.ndarray, "t n"], limits: JointLimits) -> Float[np.ndarray, "t n"]:
    """Return 0 in the middle of each joint's range, 1 at its ends; 0 for joints that turn without end."""
    limited = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    lower, upper = np.where(limited, limits.lower, 0.0), np.where(limited, limits.upper, 0.0)
    offset = np.abs(position - (lower + upper) / 2)
    return np.where(limited, offset / np.maximum((upper - lower) / 2, TOLERANCE), 0.0)
