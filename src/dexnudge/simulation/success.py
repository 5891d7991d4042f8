"""When a push or a lift counts as a success, judged on the trace of what was played."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.motion import Motion
from dexnudge.simulation.hand_path import SETTLE
from dexnudge.simulation.rollout import Trace

LEAST_ADVANCE = 0.8  # of the length and of the angle asked for
MOST_TURNED = 15.0  # [deg] away from the motion
MOST_PENETRATION = 0.002  # [m] of the hand in the surroundings
MOST_SUNK = 0.02  # [m] of the centre of mass below its path: the object has left what carried it
MOST_ASIDE = 0.02  # [m] of the centre of mass beside its path, of an object that turns
# The limit on a link's force is what its motor and tendon can hold. An impact, over within milliseconds, loads neither; what
# is pressed for this long, they hold. The rest is what forces scatter while an object sticks and slides.
FORCE_WINDOW, FORCE_TOLERANCE = 0.1, 1.02  # [s], [-]
LEAST_RAISED = 0.8  # of the lift, at its end and at every moment of the hold; the rest may be lost to tilting


@dataclass(frozen=True)
class PushVerdict:
    """The verdict on a push; `outcome` is the first condition that fails, figures are over the whole push.

    length_asked, length_reached: slide of the object's centre of mass [m], from before the hand touched it to the end.
    angle_asked, angle_reached: turn about the motion's axis [rad], as far; 0 where the object only slides. turned_deg:
    largest angle of the object's orientation from those of its motion at any record. sunk: farthest below where the motion
    has the centre of mass [m]. aside: farthest beside that, level [m]; 0 where the object only slides. hand_environment:
    greatest depth of the hand in its surroundings [m] by MuJoCo's contacts. link_force: greatest normal force of a link on
    the object [N], mean over 0.1 s.
    """

    outcome: Outcome
    length_asked: float
    length_reached: float
    angle_asked: float
    angle_reached: float
    turned_deg: float
    sunk: float
    aside: float
    hand_environment: float
    link_force: float

    @property
    def success(self) -> bool:
        """Whether every condition holds."""
        return self.outcome is Outcome.SUCCESS


def judge_push(trace: Trace, *, motion: Motion, length: float, max_normal_force: float, diverged: bool) -> PushVerdict:
    """Judge a push that should have moved the object by `length` [m] along its `motion`.

    Of each stage of it the object must have made 80 % at the end. No link may press harder on the object than
    `max_normal_force` [N] on average over any 0.1 s.
    """
    start = max(0, int(np.argmax(trace.phase != SETTLE)) - 1)  # the last record before the hand first came
    turned, slid, off = _made(motion, length, trace.object_pose[start:])
    sunk = float((slid @ motion.direction * motion.direction[2] - slid[:, 2]).max())
    angle_asked, length_asked = motion.angle(length), motion.slid(length)
    angle_reached, length_reached = float(turned[-1]), float((slid @ motion.direction)[-1])
    beside = slid[:, :2] - (slid @ motion.direction)[:, None] * (motion.direction[:2] if length_asked > 0 else 0.0)
    aside = float(np.linalg.norm(beside, axis=1).max()) if motion.turn is not None else 0.0
    turned_deg, depth = float(np.degrees(off).max()), float(trace.hand_environment_depth.max())
    force = float(lasting_forces(trace.time, trace.link_force).max())
    failures = {
        Outcome.DIVERGED: diverged,
        Outcome.DROPPED: sunk > MOST_SUNK,
        Outcome.TURNED: turned_deg >= MOST_TURNED,
        Outcome.DRIFTED: aside > MOST_ASIDE,
        Outcome.TURNED_SHORT: angle_reached < LEAST_ADVANCE * angle_asked,
        Outcome.FELL_SHORT: length_asked > 0 and length_reached < LEAST_ADVANCE * length_asked,
        Outcome.HAND_IN_ENVIRONMENT: depth > MOST_PENETRATION,
        Outcome.PRESSED_TOO_HARD: not force <= FORCE_TOLERANCE * max_normal_force,  # so is NaN
    }
    outcome = next((outcome for outcome, failed in failures.items() if failed), Outcome.SUCCESS)
    return PushVerdict(
        outcome, length_asked, length_reached, angle_asked, angle_reached, turned_deg, sunk, aside, depth, force
    )


def _made(
    motion: Motion, length: float, poses: Float[np.ndarray, "record 7"]
) -> tuple[Float[np.ndarray, " record"], Float[np.ndarray, "record 3"], Float[np.ndarray, " record"]]:
    """Return what an object has made of its motion since the first of its poses.

    The turn about the axis [rad]: that part of its rotation (swing-twist decomposition). The slide of its centre of mass
    [m, world] from where that turn alone had brought it. The angle [rad] between its orientation and the nearest one of the
    motion.
    """
    centres, quaternions = poses[:, :3], poses[:, 3:]
    if motion.turn is None:
        cosines = np.minimum(1.0, np.abs(quaternions @ quaternions[0]))
        return np.zeros(len(poses)), centres - centres[0], 2 * np.arccos(cosines)
    rotation = Rotation.from_quat(quaternions, scalar_first=True)
    rotation = rotation * rotation[0].inv()
    vector, scalar = rotation.as_quat()[:, :3], rotation.as_quat()[:, 3]
    turned = np.unwrap(2 * np.arctan2(vector @ motion.turn.axis, scalar))
    planned = Rotation.from_rotvec(np.clip(turned, 0.0, motion.angle(length))[:, None] * motion.turn.axis)
    about = Rotation.from_rotvec(turned[:, None] * motion.turn.axis)
    arm = centres[0] - motion.turn.point
    return turned, centres - motion.turn.point - about.apply(arm), (rotation * planned.inv()).magnitude()


def lasting_forces(
    time: Float[np.ndarray, " record"], link_force: Float[np.ndarray, "record link"], *, window: float = FORCE_WINDOW
) -> Float[np.ndarray, " link"]:
    """Return the greatest force of each link [N], mean over any `window` [s] of a trace; 0 where that is shorter."""
    impulse = np.cumsum(link_force * np.diff(time, prepend=time[0])[:, None], axis=0)
    begin = np.searchsorted(time, time - window + 1e-9, side="right") - 1  # 1e-9 s: times are rounded
    end = np.flatnonzero(begin >= 0)
    begin = begin[end]
    means = (impulse[end] - impulse[begin]) / (time[end] - time[begin])[:, None]
    return np.asarray(means.max(axis=0, initial=0.0))


@dataclass(frozen=True)
class LiftVerdict:
    """The verdict on a lift; `phase` is "" where it succeeded, else "lift" or "hold".

    raised: of the object's centre of mass at the end of the lift [m]. least_held: the least while it was held [m].
    turned_deg: from the object's orientation before the fingers closed to the end. hand_environment: greatest depth of the
    hand in its surroundings by MuJoCo's contacts [m]. link_force: greatest normal force of a link on the object [N], mean
    over 0.1 s, which is not judged: a grasp holds as firmly as it must.
    """

    phase: str
    outcome: Outcome
    raised: float
    least_held: float
    turned_deg: float
    hand_environment: float
    link_force: float


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
    force = float(lasting_forces(trace.time[mine][first:], trace.link_force[mine][first:]).max())
    return LiftVerdict(*failed, top, lowest, float(np.degrees(2 * np.arccos(cosine))), depth, force)
