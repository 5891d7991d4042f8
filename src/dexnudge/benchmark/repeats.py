"""Draws that an answer holds more than once: each counts as one."""

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.formats.hand_poses import palm_poses
from dexnudge.hands.hand import ROOT_COORDINATES, Hand

SAME_PLACE = 1e-3  # [m] of the palm, and of joints that slide: what the judge lets a hand be in something
SAME_ANGLE = 1e-2  # [rad] of the palm, and of joints that turn: 1 mm at a fingertip 0.1 m away


def repeated(q: Float[np.ndarray, "n coordinates"], hand: Hand) -> Bool[np.ndarray, " n"]:
    """Return which draws repeat an earlier one that does not: palm and every joint are where they are there.

    Palm within `SAME_PLACE` and `SAME_ANGLE`, joints within `SAME_ANGLE`, those that slide within `SAME_PLACE`. A draw that
    is NaN repeats none.

    q: (n, 9 + d), in one frame [m, rad].
    """
    again = np.zeros(len(q), dtype=bool)
    posed = np.flatnonzero(np.isfinite(q).all(axis=1))
    poses, joints = palm_poses(q[posed]), q[posed, ROOT_COORDINATES:]
    close = np.where(hand.sliding, SAME_PLACE, SAME_ANGLE)
    chord = 2.0 * np.sqrt(2.0) * np.sin(SAME_ANGLE / 2.0)  # Frobenius norm between two rotations SAME_ANGLE apart
    kept: list[int] = []
    for row in range(len(posed)):
        same = np.linalg.norm(poses[kept, :3, 3] - poses[row, :3, 3], axis=-1) <= SAME_PLACE
        same &= np.linalg.norm(poses[kept, :3, :3] - poses[row, :3, :3], axis=(-2, -1)) <= chord
        same &= (np.abs(joints[kept] - joints[row]) <= close).all(axis=-1)
        if same.any():
            again[posed[row]] = True
        else:
            kept.append(row)
    return again
