"""One simulation that goes on: pushes, ways through the air, grasps and lifts played one after another on the same state.

Nothing is ever put anywhere between them: each begins where the one before left hand and object.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.hands.physical import POSITION_GAIN
from dexnudge.simulation.drive import PHASES, Drive
from dexnudge.simulation.hand_path import Configurations, palm_velocity, rotations
from dexnudge.simulation.push import FASTEST, RECORD_STEPS, STATE, run_push
from dexnudge.simulation.push_forces import PushForces
from dexnudge.simulation.push_model import ENVIRONMENT_SIDE, OBJECT_SIDE, PushModel
from dexnudge.simulation.records import Records, contact_force_sums, hand_in_environment, record_now

IDLE_TORQUE = 1.0e-3  # [N m] below which a motor has no part in the squeeze and keeps its place, as in the hold test
CLOSING_STEPS = 10  # between two updates of the squeeze: 20 ms
CLOSE_RAMP, CLOSE_TIME, SETTLE_TIME = 0.1, 0.2, 0.1  # [s] of a grasp that closes, as in the hold test


@dataclass(frozen=True, kw_only=True)
class Trace(Records):
    """Records of what happened.

    phase: its name; attempt: number of the try, from 1; carried: normal force of the surroundings on the object [N], NaN
    during a push.
    """

    phase: np.ndarray
    attempt: Int[np.ndarray, " record"]
    carried: Float[np.ndarray, " record"]


class _Resumed(PushModel):
    """A model whose runs go on from the state that `data` is in."""

    def place(self, q: Float[np.ndarray, " coordinates"]) -> None:
        """Leave hand and object where they are."""


class Episode:
    """A simulation from the hand at `q_start` (world) and the object where the model's scene has it.

    With `recorded` off there are no records, which take longer than the simulation.

    Attributes:
        push: the model; `data` is the state now.
        told: configuration that hand and fingers were told last.
        attempt: number of the try that records belong to.
        diverged: whether the simulation got out of hand; nothing is played after that.
        last_state: MuJoCo's integration state at the last record before a divergence.
    """

    def __init__(self, push: PushModel, q_start: Float[np.ndarray, " coordinates"], *, recorded: bool = True) -> None:
        self.push, self._recorded = push, recorded
        self.told = np.array(q_start, dtype=np.float64)
        self.attempt, self.diverged = 1, False
        self._columns: dict[str, list] = {field.name: [] for field in fields(Trace)}
        self._grip: np.ndarray | None = None
        push.place(self.told)
        self.last_state = self._state()
        model = push.model
        self._low, self._high = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])

    @property
    def T_world_object(self) -> Float[np.ndarray, "4 4"]:
        """Where the object is now; exactly rigid."""
        free = self.push.object_position
        pose = np.eye(4)
        quaternion = self.push.data.qpos[free + 3 : free + 7]
        pose[:3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        pose[:3, 3] = self.push.data.qpos[free : free + 3]
        return pose

    @property
    def q(self) -> Float[np.ndarray, " coordinates"]:
        """Where the hand is now."""
        return self.push.configurations(self.push.data.qpos[None])[0]

    @property
    def trace(self) -> Trace:
        """All records so far."""
        return Trace(**{name: np.array(column) for name, column in self._columns.items()})

    @contextmanager
    def elsewhere(self) -> Iterator[None]:
        """Inside, the model's data may be used for anything; afterwards they are what they were."""
        kept = self._state()
        yield
        model, data = self.push.model, self.push.data
        mujoco.mj_setState(model, data, kept, STATE)
        mujoco.mj_forward(model, data)  # what follows from the state; changes the warm start
        mujoco.mj_setState(model, data, kept, STATE)

    def slide(self, drive: Drive, forces: PushForces) -> None:
        """Play a push; see `simulation.push.run_push`."""
        resumed = _Resumed(**{field.name: getattr(self.push, field.name) for field in fields(PushModel)})
        run = run_push(resumed, self.told, drive, forces)
        self._grip = None
        new = run.time > (self._columns["time"][-1] if self._columns["time"] else -1.0)
        for field in fields(Records):
            self._columns[field.name].extend(getattr(run, field.name)[new])
        self._columns["phase"].extend(PHASES[phase] for phase in run.phase[new])
        self._columns["attempt"].extend([self.attempt] * int(new.sum()))
        self._columns["carried"].extend([np.nan] * int(new.sum()))
        self.diverged, self.last_state = run.diverged_at >= 0, run.last_state
        end = np.concatenate([run.mocap[-1, :3], np.zeros(6), drive.angles[-1]])
        matrix = Rotation.from_quat(drive.quaternion[-1], scalar_first=True).as_matrix()
        end[3:6], end[6:9] = matrix[:, 0], matrix[:, 1]
        self.told = end

    def play(self, path: Configurations, phase: str) -> None:
        """Tell the hand to follow `path`; the fingers keep their grip where there is one."""
        motors = path[:, ROOT_COORDINATES:] @ self.push.indices.motor_of_angle.T
        self._run(path, motors if self._grip is None else np.tile(self._grip, (len(path), 1)), phase)

    def carry_on(self, path: Configurations, phase: str) -> None:
        """The base goes on along `path` with fingers and base pressing as they are told to now."""
        data = self.push.data
        motors = np.tile(np.array(data.ctrl), (len(path), 1))
        self._run(path, motors, phase, pressing=np.array(data.ctrl[self.push.base_motor]))

    def close(self, motor_torque: Float[np.ndarray, " motor"], phase: str, *, ramp: float, seconds: float) -> None:
        """Bring the motors to these torques [N m] within `ramp` seconds of `seconds`, whatever gaps they close on the way.

        Afterwards they keep the targets that they have then, until `let_go`.
        """
        idle = np.abs(motor_torque) < IDLE_TORQUE
        place = self.push.indices.motor_of_angle @ self.told[ROOT_COORDINATES:]
        step = self.push.model.opt.timestep * CLOSING_STEPS
        updates = round(seconds / step)
        path = np.tile(self.told, (CLOSING_STEPS, 1))
        for update in range(updates):
            share = min(1.0, (update + 1) * step / ramp)
            target = self.push.data.actuator_length + share * motor_torque / POSITION_GAIN
            self._grip = np.where(idle, place, target)
            self._run(path, np.tile(self._grip, (CLOSING_STEPS, 1)), phase)

    def let_go(self) -> None:
        """From here on the fingers follow their path again."""
        self._grip = None

    def _run(
        self,
        path: Configurations,
        motors: Float[np.ndarray, "step motor"],
        phase: str,
        *,
        pressing: Float[np.ndarray, " 6"] | float = 0.0,
    ) -> None:
        if self.diverged or len(path) == 0:
            return
        push, model, data = self.push, self.push.model, self.push.data
        moving = push.base_damping * palm_velocity(path, self.told) / push.base_stiffness
        quaternions = rotations(path).as_quat(scalar_first=True)
        deepest = 0.0
        for step in range(len(path)):
            data.mocap_pos[0], data.mocap_quat[0] = path[step, :3], quaternions[step]
            data.ctrl[:] = np.clip(motors[step], self._low, self._high)
            data.ctrl[push.base_motor] = moving[step] + pressing
            mujoco.mj_step(model, data)
            if not np.abs(data.qvel).max() < FASTEST:  # NaN is not below anything
                self.diverged = True
                return
            if not self._recorded:
                continue
            deepest = max(deepest, hand_in_environment(push))
            if (step + 1) % RECORD_STEPS == 0 or step + 1 == len(path):
                self._record(phase, deepest)
                deepest = 0.0
        self.told = path[-1].copy()

    def _record(self, phase: str, deepest: float) -> None:
        record = {
            **record_now(self.push, deepest),
            "phase": phase,
            "attempt": self.attempt,
            "carried": contact_force_sums(self.push, OBJECT_SIDE, ENVIRONMENT_SIDE)[0],
        }
        for name, value in record.items():
            self._columns[name].append(value)
        self.last_state = self._state()

    def _state(self) -> Float[np.ndarray, " state"]:
        state = np.zeros(mujoco.mj_stateSize(self.push.model, STATE))
        mujoco.mj_getState(self.push.model, self.push.data, state, STATE)
        return state
