"""Whether a lifted object came up, and stayed up while it was held."""

from dataclasses import dataclass

import numpy as np

from dexnudge.simulation.episode import Trace

LEAST_RAISED = 0.8  # of the lift, at its end and at every moment of the hold; the rest may be lost to tilting
MOST_PENETRATION = 0.002  # [m] of the hand in the surroundings, as for a push


@dataclass(frozen=True)
class LiftVerdict:
    """phase: "" where it succeeded, else "lift" or "hold"; reason: what happened then.

    raised: of the object's centre of mass at the end of the lift [m]. least_held: the least while it was held [m].
    turned_deg: from the object's orientation before the fingers closed to the end. hand_environment: greatest depth of the
    hand in its surroundings by MuJoCo's contacts [m].
    """

    phase: str
    reason: str
    raised: float
    least_held: float
    turned_deg: float
    hand_environment: float


def judge_lift(trace: Trace, *, attempt: int, height: float) -> LiftVerdict:
    """The verdict on the lift by `height` [m] of this try, which begins with its last phase "reach".

    It has to stand at least 80 % of the height above where it lay, at the end of the lift and at every record of the hold,
    without touching the surroundings.
    """
    mine = trace.attempt == attempt
    phase, z = trace.phase[mine], trace.object_pose[mine, 2]
    first = int(np.flatnonzero(phase == "reach")[0])
    raised = z - z[first]
    lifted, held = raised[phase == "lift"], raised[phase == "hold"]
    carried = trace.carried[mine][phase == "hold"]
    cosine = min(1.0, abs(float(trace.object_pose[mine][first, 3:] @ trace.object_pose[mine][-1, 3:])))
    depth = float(trace.hand_environment_depth[mine][first:].max())
    least = LEAST_RAISED * height
    top = float(lifted[-1]) if len(lifted) else 0.0
    lowest = float(held.min()) if len(held) else 0.0
    if top < least:
        failed = ("lift", f"slipped on lift: raised {1e3 * top:.0f} of {1e3 * height:.0f} mm")
    elif lowest < least:
        failed = ("hold", f"dropped in hold: sank to {1e3 * lowest:.0f} of {1e3 * height:.0f} mm")
    elif carried.max() > 0:
        failed = ("hold", "the surroundings still carry it")
    elif depth > MOST_PENETRATION:
        failed = ("lift", f"hand {1e3 * depth:.1f} mm into the environment")
    else:
        failed = ("", "")
    return LiftVerdict(*failed, top, lowest, float(np.degrees(2 * np.arccos(cosine))), depth)
