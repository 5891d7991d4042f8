"""How far an object has moved in a test, and whether it has come to rest."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

FARTHEST = 0.05  # [m] this and the next are DexGraspBench's limits of a grasp that holds
MOST_TURNED = float(np.radians(15.0))

FIRST_STOP = 8  # looks before an object can be called at rest: 0.3 s, many time constants of the motors
WINDOW = 2  # looks over which its speed is taken
REST_SHARE = 0.1  # of a limit that it would still cover at that speed
SPEED_UP = 4.0  # it must stay within the limits even at this many times that speed


@dataclass(frozen=True)
class ObjectPose:
    """centre: of mass [m]. quaternion: wxyz, unit."""

    centre: Float[np.ndarray, " 3"]
    quaternion: Float[np.ndarray, " 4"]

    def distance(self, other: "ObjectPose") -> tuple[float, float]:
        """(translation of the centre of mass [m], angle of rotation [rad]) between two poses."""
        cosine = min(1.0, abs(float(self.quaternion @ other.quaternion)))
        return float(np.linalg.norm(self.centre - other.centre)), 2.0 * float(np.arccos(cosine))

    def share(self, other: "ObjectPose") -> float:
        """The distance in units of the limits, of translation or rotation whichever is the larger: above 1 it drops."""
        translation, rotation = self.distance(other)
        return max(translation / FARTHEST, rotation / MOST_TURNED)


def at_rest(start: ObjectPose, poses: Sequence[ObjectPose], looks_left: int) -> bool:
    """Whether the looks that are left cannot change that the object holds.

    It is no faster now than in the window before; at its present speed it would cover less than a tenth of the limits in
    what is left; and even at four times that speed it would stay within nine tenths of them.

    Args:
        start: where the limits are measured from.
        poses: one per look since the pull began.
        looks_left: until the pull ends.
    """
    if len(poses) < max(FIRST_STOP, 2 * WINDOW + 1):
        return False
    now, before, long_before = poses[-1], poses[-1 - WINDOW], poses[-1 - 2 * WINDOW]
    windows = looks_left / WINDOW
    ahead = now.share(before) * windows
    slowing = now.share(before) <= before.share(long_before)
    return slowing and ahead < REST_SHARE and start.share(now) + SPEED_UP * ahead < 1.0 - REST_SHARE
