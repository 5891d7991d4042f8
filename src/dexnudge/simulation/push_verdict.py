"""Whether a push did what it should: advanced, not turned, not dropped, the hand not in its surroundings."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.simulation.drive import SETTLE
from dexnudge.simulation.push import PushRun

LEAST_ADVANCE = 0.8  # of the way
MOST_TURNED = 15.0  # [deg]
MOST_PENETRATION = 0.002  # [m] of the hand in the surroundings
MOST_SUNK = 0.02  # [m] of the centre of mass below its line: the object has left what carried it


@dataclass(frozen=True)
class PushVerdict:
    """success, and else the first reason that fails; figures over the whole run.

    advanced: of the object's centre of mass along the motion, from before the hand touched it to the end [m].
    turned_deg: largest angle from the object's first orientation at any record. sunk: farthest below the line that it
    should move on [m]. hand_environment: greatest depth of the hand in its surroundings [m] by MuJoCo's contacts.
    """

    success: bool
    reason: str
    advanced: float
    turned_deg: float
    sunk: float
    hand_environment: float


def judge_push(run: PushRun, *, motion: Float[np.ndarray, " 3"], length: float) -> PushVerdict:
    """The verdict on a run that should have moved the object by `length` [m] along `motion` (unit, world)."""
    untouched = np.flatnonzero(run.phase == SETTLE)
    start = int(untouched[-1]) if len(untouched) else 0
    centres, quaternions = run.object_pose[start:, :3], run.object_pose[start:, 3:]
    moved = centres - centres[0]
    along = moved @ motion
    sunk = float((along * motion[2] - moved[:, 2]).max())
    cosines = np.minimum(1.0, np.abs(quaternions @ quaternions[0]))
    turned = float(np.degrees(2 * np.arccos(cosines)).max())
    depth = float(run.hand_environment_depth.max())
    advanced = float(along[-1])
    reasons = {
        f"diverged at step {run.diverged_at}": run.diverged_at >= 0,
        "dropped": sunk > MOST_SUNK,
        f"turned {turned:.0f} deg": turned >= MOST_TURNED,
        f"advanced {1e3 * advanced:.0f} of {1e3 * length:.0f} mm": advanced < LEAST_ADVANCE * length,
        f"hand {1e3 * depth:.1f} mm into the environment": depth > MOST_PENETRATION,
    }
    reason = next((text for text, failed in reasons.items() if failed), "")
    return PushVerdict(not reason, reason, advanced, turned, sunk, depth)
