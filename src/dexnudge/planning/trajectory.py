"""A hand's motion over time, as fast as its limits allow."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, OutputError
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.planning.hand_states import States, StateSpace, between, rotation_angle


@dataclass(frozen=True, kw_only=True)
class SpeedLimits:
    """Limits that a trajectory keeps.

    base: of the palm's origin [m/s]. base_rotation: of the palm's turning [rad/s]. joint: of every finger joint [rad/s].
    contact: of the palm's origin on the last stretch, where the fingers meet the object [m/s].

    Raises:
        InputError: a limit that is not a finite number above 0.
    """

    base: float = 0.25
    base_rotation: float = 1.5  # a wrist's usual half of its rated speed
    joint: float = 2.0
    contact: float = 0.05

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"the speed limit {name} is {value}; expected a finite number above 0")


SAMPLE_INTERVAL = 0.02  # [s] most between two samples: 5 mm at the base's default speed


@dataclass(frozen=True)
class Trajectory:
    """Configurations of a hand at increasing times.

    Attributes:
        times: (T,) [s], from 0.
        q: (T, 9 + d) [translation (3) [m] | first two columns of R (6) | joint angles (d) [rad]], world frame. Between two
            samples everything but the rotation is linear; the rotation turns about one axis.
        joint_names: the d joints in the order of q.

    Raises:
        InputError: arrays that do not fit together, times that do not increase, or numbers that are not finite.
    """

    times: Float[np.ndarray, " sample"]
    q: Float[np.ndarray, "sample coordinates"]
    joint_names: tuple[str, ...]

    def __post_init__(self) -> None:
        expected = (len(self.times), ROOT_COORDINATES + len(self.joint_names))
        if self.q.shape != expected or len(self.times) == 0:
            raise InputError(
                f"the trajectory's q has shape {self.q.shape}; expected {expected} with at least one sample"
            )
        if not (np.isfinite(self.times).all() and np.isfinite(self.q).all()):
            raise InputError("the trajectory holds NaN or infinity; expected finite numbers")
        if (np.diff(self.times) <= 0).any():
            raise InputError("the trajectory's times do not increase; expected each to be later than the one before")

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0])

    def save(self, path: Path) -> None:
        """Write an npz archive with the arrays times, q and joint_names (text).

        Raises:
            OutputError: the file cannot be written.
        """
        try:
            with path.open("wb") as file:
                np.savez(file, times=self.times, q=self.q, joint_names=np.array(self.joint_names, dtype=np.str_))
        except OSError as error:
            raise OutputError(
                f"{path}: the trajectory cannot be written ({error.strerror}); expected a file in a folder that you may "
                "write to"
            ) from error


def timed(
    space: StateSpace, path: States, joint_names: tuple[str, ...], limits: SpeedLimits, *, contact_from: int
) -> Trajectory:
    """A path of states, run through as fast as the limits allow, each straight piece at constant speed.

    Duration of a piece = the longest of translation / base, turn / base_rotation and the greatest change of a joint angle
    / joint. From the state `contact_from` on, the base keeps to the slower limit `contact`.
    """
    fastest_joint = float(np.abs(space.opened - space.closed).max())
    times, states = [0.0], [path[:1]]
    for index, (start, end) in enumerate(pairwise(path)):
        speed = limits.contact if index >= contact_from else limits.base
        seconds = max(
            float(np.linalg.norm(end[:3] - start[:3])) / speed,
            rotation_angle(start, end) / limits.base_rotation,
            abs(end[7] - start[7]) * fastest_joint / limits.joint,
        )
        if seconds == 0.0:
            continue
        count = int(np.ceil(seconds / SAMPLE_INTERVAL))
        fraction = np.arange(1, count + 1) / count
        times += list(times[-1] + fraction * seconds)
        states.append(between(start, end, fraction))
    return Trajectory(np.array(times), space.configurations(np.concatenate(states)), joint_names)


def joined(first: Trajectory | None, second: Trajectory) -> Trajectory:
    """`first`, then `second`, which begins where `first` ends."""
    if first is None or first.duration == 0.0:
        return second
    times = np.concatenate([first.times, first.times[-1] + second.times[1:]])
    return Trajectory(times, np.concatenate([first.q, second.q[1:]]), second.joint_names)
