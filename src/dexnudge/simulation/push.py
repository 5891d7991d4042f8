"""A push in MuJoCo: the hand closes in, squeezes with the forces of the balance, and carries the object along."""

import time
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.hands.physical import POSITION_GAIN
from dexnudge.simulation.drive import SETTLE, SQUEEZE, Drive, interpolated
from dexnudge.simulation.push_forces import PushForces
from dexnudge.simulation.push_model import TIMESTEP, PushModel
from dexnudge.simulation.records import Records, hand_in_environment, record_now

RECORD_STEPS = 10  # between two records: 20 ms
TOUCHING, LOADED = 0.3, 0.8  # of the time of the squeeze: fingers have closed, forces are built up; the rest settles
FASTEST = 100.0  # [m/s, rad/s] anything faster is a simulation out of hand
FOLLOW_TIME = 0.05  # [s] in which the base's target goes down or up to where the pressing hand has come to rest
MOST_FOLLOWED = 0.005  # [m]
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True, kw_only=True)
class PushRun(Records):
    """Records of one run, the first of the start.

    Attributes:
        phase: see `drive.PHASES`.
        diverged_at: step at which the state was no longer finite or anything went faster than 100 m/s; -1 if never.
        last_state: MuJoCo's integration state at the last record, to replay what follows from.
        last_step: the step it belongs to, -1 the start. seconds: wall time of the simulation, records included.
    """

    phase: Int[np.ndarray, " record"]
    diverged_at: int
    last_state: Float[np.ndarray, " state"]
    last_step: int
    seconds: float


def run_push(push: PushModel, q_start: Float[np.ndarray, " coordinates"], drive: Drive, forces: PushForces) -> PushRun:
    """Simulate `drive` from the hand at `q_start`; the same arguments give the same run, whatever ran before.

    Pressing, the base is told a force and no height: as fingers give way the hand sinks, and a target that stayed would
    pull it up by as much as it should press. So the target's height follows, by up to 5 mm.
    """
    began = time.perf_counter()
    push.place(q_start)
    model, data = push.model, push.data
    records, phases = [record_now(push, 0.0)], [int(drive.phase[0])]
    last_state = np.zeros(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, last_state, STATE)
    deepest, last_step, diverged_at = 0.0, -1, -1
    place = drive.angles @ push.indices.motor_of_angle.T
    low, high = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
    squeezing = np.flatnonzero(drive.phase == SQUEEZE)
    to_base = Rotation.from_quat(drive.quaternion, scalar_first=True).inv()
    moving = _in_base(to_base, push.base_damping * drive.velocity) / push.base_stiffness
    places = np.linspace(0.0, 1.0, len(forces.force))
    pressing = _in_base(to_base, interpolated(drive.done, places, forces.base_wrench)) / push.base_stiffness
    torque = interpolated(drive.done, places, forces.motor_torque)
    closed = loaded = followed = 0.0
    for step in range(len(drive.phase)):
        if drive.phase[step] == SQUEEZE:
            done = (step - squeezing[0] + 1) / len(squeezing)
            closed, loaded = np.clip([done / TOUCHING, (done - TOUCHING) / (LOADED - TOUCHING)], 0.0, 1.0)
        data.mocap_pos[0] = drive.position[step] + closed * forces.base_closing
        if loaded > 0:
            sunk = data.qpos[push.palm_position + 2] - data.mocap_pos[0, 2]
            followed += TIMESTEP / FOLLOW_TIME * (sunk - followed)
            followed = float(np.clip(followed, -MOST_FOLLOWED, MOST_FOLLOWED))
            data.mocap_pos[0, 2] += followed
        data.mocap_quat[0] = drive.quaternion[step]
        offset = closed * forces.closing + loaded * torque[step] / POSITION_GAIN
        data.ctrl[:] = np.clip(place[step] + offset, low, high)
        data.ctrl[push.base_motor] = moving[step] + loaded * pressing[step]
        mujoco.mj_step(model, data)
        if not np.abs(data.qvel).max() < FASTEST:  # NaN is not below anything
            diverged_at = step
            break
        deepest = max(deepest, hand_in_environment(push))
        if (step + 1) % RECORD_STEPS == 0 or step + 1 == len(drive.phase):
            records.append(record_now(push, deepest))
            phases.append(int(drive.phase[step]))
            mujoco.mj_getState(model, data, last_state, STATE)
            deepest, last_step = 0.0, step
    return PushRun(
        **{name: np.array([record[name] for record in records]) for name in records[0]},
        phase=np.array(phases),
        diverged_at=diverged_at,
        last_state=last_state,
        last_step=last_step,
        seconds=time.perf_counter() - began,
    )


def _in_base(to_base: Rotation, wrench: Float[np.ndarray, "step 6"]) -> Float[np.ndarray, "step 6"]:
    """Force and torque per step, given in the world's axes, in those of the base's target."""
    return np.concatenate([to_base.apply(wrench[:, :3]), to_base.apply(wrench[:, 3:])], axis=1)


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
