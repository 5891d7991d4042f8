"""How much of each joint's limits a trajectory uses, at every millisecond."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import JointLimits
from dexnudge.trajectories.interpolation import densely
from dexnudge.trajectories.plan import JointTrajectory

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
