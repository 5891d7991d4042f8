"""How fast a hand may move."""

from dataclasses import dataclass

import numpy as np

from dexnudge.errors import InputError


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
