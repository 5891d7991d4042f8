"""When a push or a lift counts as a success, judged on the trace of what was played."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.planning.outcomes import Outcome
from dexnudge.simulation.hand_path import SETTLE
from dexnudge.simulation.rollout import Trace

LEAST_ADVANCE = 0.8  # of the length asked for
MOST_TURNED = 15.0  # [deg]
MOST_PENETRATION = 0.002  # [m] of the hand in the surroundings
MOST_SUNK = 0.02  # [m] of the centre of mass below its line: the object has left what carried it
LEAST_RAISED = 0.8  # of the lift, at its end and at every moment of the hold; the rest may be lost to tilting


@dataclass(frozen=True)
class PushVerdict:
    """The verdict on a push; `outcome` is the first condition that fails, figures are over the whole push.

    length_reached: displacement of the object's centre of mass along the motion [m], from before the hand touched it to the
    end.
    turned_deg: largest angle from the object's first orientation at any record. sunk: farthest below the line on which it
    should move [m]. hand_environment: greatest depth of the hand in its surroundings [m] by MuJoCo's contacts.
    """

    outcome: Outcome
    length_asked: float
    length_reached: float
    turned_deg: float
    sunk: float
    hand_environment: float

    @property
    def success(self) -> bool:
        """Whether every condition holds."""
        return self.outcome is Outcome.SUCCESS


def judge_push(trace: Trace, *, motion: Float[np.ndarray, " 3"], length: float, diverged: bool) -> PushVerdict:
    """Judge a push that should have moved the object by `length` [m] along `motion` (unit, world)."""
    untouched = np.flatnonzero(trace.phase == SETTLE)
    start = int(untouched[-1]) if len(untouched) else 0
    centres, quaternions = trace.object_pose[start:, :3], trace.object_pose[start:, 3:]
    moved = centres - centres[0]
    along = moved @ motion
    sunk = float((along * motion[2] - moved[:, 2]).max())
    cosines = np.minimum(1.0, np.abs(quaternions @ quaternions[0]))
    turned = float(np.degrees(2 * np.arccos(cosines)).max())
    depth = float(trace.hand_environment_depth.max())
    reached = float(along[-1])
    failures = {
        Outcome.DIVERGED: diverged,
        Outcome.DROPPED: sunk > MOST_SUNK,
        Outcome.TURNED: turned >= MOST_TURNED,
        Outcome.FELL_SHORT: reached < LEAST_ADVANCE * length,
        Outcome.HAND_IN_ENVIRONMENT: depth > MOST_PENETRATION,
    }
    outcome = next((outcome for outcome, failed in failures.items() if failed), Outcome.SUCCESS)
    return PushVerdict(outcome, length, reached, turned, sunk, depth)


@dataclass(frozen=True)
class LiftVerdict:
    """The verdict on a lift; `phase` is "" where it succeeded, else "lift" or "hold".

    raised: of the object's centre of mass at the end of the lift [m]. least_held: the least while it was held [m].
    turned_deg: from the object's orientation before the fingers closed to the end. hand_environment: greatest depth of the
    hand in its surroundings by MuJoCo's contacts [m].
    """

    phase: str
    outcome: Outcome
    raised: float
    least_held: float
    turned_deg: float
    hand_environment: float


def judge_lift(trace: Trace, *, attempt: int, height: float) -> LiftVerdict:
    """Judge the lift by `height` [m] of an attempt, which begins with its last phase "reach".

    The object has to stand at least 80 % of the height above where it lay, at the end of the lift and at every record of
    the hold, without touching the surroundings.
    """
    mine = trace.attempt == attempt
    phase, z = trace.phase[mine], trace.object_pose[mine, 2]
    first = int(np.flatnonzero(phase == "reach")[0])
    raised = z - z[first]
    lifted, held = raised[phase == "lift"], raised[phase == "hold"]
    carried = trace.support_force[mine][phase == "hold"]
    cosine = min(1.0, abs(float(trace.object_pose[mine][first, 3:] @ trace.object_pose[mine][-1, 3:])))
    depth = float(trace.hand_environment_depth[mine][first:].max())
    least = LEAST_RAISED * height
    top = float(lifted[-1]) if len(lifted) else 0.0
    lowest = float(held.min()) if len(held) else 0.0
    if top < least:
        failed = ("lift", Outcome.SLIPPED)
    elif lowest < least:
        failed = ("hold", Outcome.SANK)
    elif carried.max() > 0:
        failed = ("hold", Outcome.STILL_CARRIED)
    elif depth > MOST_PENETRATION:
        failed = ("lift", Outcome.HAND_IN_ENVIRONMENT)
    else:
        failed = ("", Outcome.SUCCESS)
    return LiftVerdict(*failed, top, lowest, float(np.degrees(2 * np.arccos(cosine))), depth)
