"""A simulation of hand and object that goes on from act to act: pushes, ways through the air, grasps and lifts.

Nothing is ever put anywhere in between: each act begins where the one before left hand and object. Every act is a series of
commands, one a step, made while the simulation runs, so that a command may depend on the state that it finds.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.simulation.contact_forces import contact_force_sums, link_forces, pair_sides
from dexnudge.simulation.hand_path import Path, PushPath, palm_velocity, rotations
from dexnudge.simulation.model import ENVIRONMENT_SIDE, HAND_SIDE, OBJECT_SIDE, TIMESTEP, SimulationModel
from dexnudge.simulation.open_loop import OpenLoop
from dexnudge.simulation.policy import Command, HandDrive, Policy, PushPlan, Senses, check_command
from dexnudge.simulation.push_forces import PushForces

RECORD_STEPS = 10  # between two records: 20 ms
FASTEST = 100.0  # [m/s, rad/s] anything faster has diverged
FAR = 0.05  # [m] clearances above this are not told apart
CLOSING_STEPS = 10  # between two updates of the squeeze: 20 ms
CLOSE_RAMP, CLOSE_TIME, GRIP_SETTLE_TIME = 0.1, 0.2, 0.1  # [s] of a grasp that closes, as in the hold test
MOST_STEPS = 10  # of a policy, times those of its plan: one that never ends a push would run for ever
STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Records of hand and object, 20 ms apart.

    Attributes:
        time: [s].
        phase: name of what the hand was doing.
        attempt: number of the attempt, from 1.
        qpos, ctrl, mocap: MuJoCo's coordinates, motor targets, and target of the base (position, quaternion wxyz), empty
            where an arm carries the hand.
        object_pose: centre of mass [m, world], quaternion wxyz of the object's frame.
        hand_object_force: sums of the normal and of the tangential forces of hand on object [N].
        link_force: sum of each hand link's normal forces on the object [N], mean since the record before.
        motor_force: what each motor exerts [N m], sliding ones [N], mean since the record before; of the base in the axes
            of its target.
        torque_share: greatest force of each motor since the record before, as a share of its limit.
        base_wrench: what carries the hand exerts on it beyond its weight: force [N], torque about the palm's origin [N m],
            world. The mean of the base's motors since the record before; of an arm what balances the hand's contacts then.
        hand_environment_clearance: [m] between convex pieces, at most 50 mm, negative where they penetrate.
        hand_environment_depth: greatest depth by MuJoCo's contacts at any step since the record before [m].
        support_force: sum of the normal forces of the surroundings on the object [N].
    """

    time: Float[np.ndarray, " record"]
    phase: np.ndarray
    attempt: Int[np.ndarray, " record"]
    qpos: Float[np.ndarray, "record nq"]
    ctrl: Float[np.ndarray, "record nu"]
    mocap: Float[np.ndarray, "record target"]
    object_pose: Float[np.ndarray, "record 7"]
    hand_object_force: Float[np.ndarray, "record 2"]
    link_force: Float[np.ndarray, "record link"]
    motor_force: Float[np.ndarray, "record nu"]
    torque_share: Float[np.ndarray, "record nu"]
    base_wrench: Float[np.ndarray, "record 6"]
    hand_environment_clearance: Float[np.ndarray, " record"]
    hand_environment_depth: Float[np.ndarray, " record"]
    support_force: Float[np.ndarray, " record"]


@dataclass(frozen=True)
class Divergence:
    """A simulation that diverged.

    step: at which the state was no longer finite or anything went faster than 100 m/s, counted from the start. state:
    MuJoCo's integration state at the last record, from which it can be replayed. last_step: to which that belongs.
    """

    step: int
    state: Float[np.ndarray, " state"]
    last_step: int


class Rollout:
    """A simulation from the hand at `q_start` (world) and the object where the model has it.

    The same acts give the same trace, whatever the model was used for before. With `recorded` off there are no records,
    which take longer than the simulation. commanded: configuration that the hand was told last. attempt: number of the one
    that records belong to. divergence: None unless the simulation diverged; nothing is played after that.
    """

    def __init__(
        self, simulation: SimulationModel, q_start: Float[np.ndarray, " coordinates"], *, recorded: bool = True
    ) -> None:
        self.simulation, self._recorded = simulation, recorded
        self.commanded = np.array(q_start, dtype=np.float64)
        self.attempt = 1
        self.divergence: Divergence | None = None
        self._steps, self._steps_each = 0, round(TIMESTEP / simulation.model.opt.timestep)  # of a command
        self._columns: dict[str, list] = {field.name: [] for field in fields(Trace)}
        self._grip: np.ndarray | None = None
        self._measured = _Measured(simulation)
        simulation.place(self.commanded)
        self._last_state, self._last_step = self._state(), 0
        self._drive = HandDrive.of(simulation)

    @property
    def T_world_object(self) -> Float[np.ndarray, "4 4"]:
        """Where the object is now; exactly rigid."""
        return self.simulation.object_poses(self.simulation.data.qpos[None])[0]

    @property
    def q(self) -> Float[np.ndarray, " coordinates"]:
        """Where the hand is now."""
        return self.simulation.configurations(self.simulation.data.qpos[None])[0]

    @property
    def trace(self) -> Trace:
        """All records so far."""
        return Trace(**{name: np.array(column) for name, column in self._columns.items()})

    @contextmanager
    def elsewhere(self) -> Iterator[None]:
        """Lend the model's data for anything; afterwards they are what they were."""
        kept = self._state()
        yield
        model, data = self.simulation.model, self.simulation.data
        mujoco.mj_setState(model, data, kept, STATE)
        mujoco.mj_forward(model, data)  # what follows from the state; changes the warm start
        mujoco.mj_setState(model, data, kept, STATE)

    def push(self, path: PushPath, forces: PushForces, policy: Policy | None = None, *, sees: bool = True) -> None:
        """Close in, squeeze with the forces, and carry the object along, as `policy` decides; open loop unless given.

        sees: whether the policy observes the object's pose.
        """
        self._grip = None
        if self._recorded and not self._columns["time"]:
            self._record(str(path.phase[0]))
        with self.elsewhere():  # at contact, fingers may be closer to each other than where they start
            self.simulation.place(np.concatenate([self.commanded[:ROOT_COORDINATES], path.angles[-1]]))
        policy = policy or OpenLoop()
        policy.start(PushPlan(path, forces, self._drive))
        most = MOST_STEPS * len(path.phase)
        self.play(self._policy_commands(policy, Senses(self.simulation, sees=sees), most=most))

    def follow(self, path: Path, phase: str) -> None:
        """Move the hand along `path`; the fingers keep their grip where there is one."""
        self.play(self._path_commands(path, phase))

    def close(self, motor_torque: Float[np.ndarray, " motor"], phase: str) -> None:
        """Bring the motors to these torques, whatever gaps they close on the way, and let the grip settle.

        In [N m]; those of motors that slide are forces [N].
        Afterwards they keep the targets that they have then, until `let_go`.
        """
        idle = self.simulation.idle(motor_torque)
        place = self.simulation.motor_of_angle @ self.commanded[ROOT_COORDINATES:]
        step = self.simulation.model.opt.timestep * CLOSING_STEPS
        path = np.tile(self.commanded, (CLOSING_STEPS, 1))
        for update in range(round(CLOSE_TIME / step)):
            share = min(1.0, (update + 1) * step / CLOSE_RAMP)
            target = self.simulation.data.actuator_length + share * motor_torque / self.simulation.motor_gain
            self._grip = np.where(idle, place, target)
            self.follow(path, phase)
        self.follow(np.tile(self.commanded, (round(GRIP_SETTLE_TIME / TIMESTEP), 1)), phase)

    def let_go(self) -> None:
        """From here on the fingers follow their path again."""
        self._grip = None

    def play(self, commands: Iterable[Command]) -> None:
        """Give the commands one after another, each for 2 ms; each is asked for when the one before is done."""
        if self.divergence is not None:
            return
        model, data = self.simulation.model, self.simulation.data
        done, command = 0, None
        for command in commands:
            if model.nmocap:
                data.mocap_pos[0], data.mocap_quat[0] = command.q[:3], command.quaternion
            data.ctrl[:] = command.ctrl
            for _ in range(self._steps_each):
                try:
                    mujoco.mj_step(model, data)
                    sound = np.abs(data.qvel).max() < FASTEST  # NaN is not below anything
                except mujoco.FatalError:  # more contacts than there is memory for
                    sound = False
                if not sound:
                    self.divergence = Divergence(self._steps, self._last_state, self._last_step)
                    return
                self._steps += 1
                if self._recorded:
                    self._measured.add()
            done += 1
            if self._recorded and done % RECORD_STEPS == 0:
                self._record(command.phase)
        if command is not None:
            if self._recorded and done % RECORD_STEPS:
                self._record(command.phase)
            self.commanded = np.array(command.q)

    def _policy_commands(self, policy: Policy, senses: Senses, *, most: int) -> Iterator[Command]:
        """Yield what the policy commands, each for what it observes then; InputError after `most` of them."""
        for _ in range(most):
            if (command := policy.command(senses.observe())) is None:
                return
            check_command(command, policy, coordinates=len(self.commanded), motors=self.simulation.model.nu)
            yield command
        raise InputError(
            f"the policy {type(policy).__name__} has given {most} commands, {MOST_STEPS} times the steps of its plan; "
            "expected None when the push is over"
        )

    def _path_commands(self, path: Path, phase: str) -> Iterator[Command]:
        """Yield the commands that lead hand and motors along."""
        if len(path) == 0:
            return
        simulation = self.simulation
        motors = path[:, ROOT_COORDINATES:] @ simulation.motor_of_angle.T
        if self._grip is not None:
            motors[:] = self._grip
        moving = simulation.base_damping * palm_velocity(path, self.commanded) / simulation.base_stiffness
        quaternions = rotations(path).as_quat(scalar_first=True)
        for step, q in enumerate(path):
            ctrl = np.clip(motors[step], self._drive.lower, self._drive.upper)
            ctrl[simulation.base_motor] = moving[step]
            yield Command(q, quaternions[step], ctrl, phase)

    def _record(self, phase: str) -> None:
        simulation, data, measured = self.simulation, self.simulation.data, self._measured
        free = simulation.object_position
        record = {
            "time": data.time,
            "phase": phase,
            "attempt": self.attempt,
            "qpos": np.array(data.qpos),
            "ctrl": np.array(data.ctrl),
            "mocap": np.concatenate([data.mocap_pos, data.mocap_quat], axis=1).ravel(),
            "object_pose": np.concatenate([data.xipos[simulation.object_body], data.qpos[free + 3 : free + 7]]),
            "hand_object_force": contact_force_sums(simulation, HAND_SIDE, OBJECT_SIDE),
            "link_force": measured.link_force / max(1, measured.steps),
            "motor_force": measured.motor_force / max(1, measured.steps),
            "torque_share": measured.greatest / simulation.model.actuator_forcerange[:, 1],
            "base_wrench": self._base_wrench(),
            "hand_environment_clearance": hand_clearance(simulation),
            "hand_environment_depth": measured.deepest,
            "support_force": contact_force_sums(simulation, OBJECT_SIDE, ENVIRONMENT_SIDE)[0],
        }
        for name, value in record.items():
            self._columns[name].append(value)
        self._measured = _Measured(simulation)
        self._last_state, self._last_step = self._state(), self._steps

    def _base_wrench(self) -> Float[np.ndarray, " 6"]:
        """Return what carries the hand exerts, about the palm's origin; see `Trace`."""
        simulation, measured = self.simulation, self._measured
        mean = measured.motor_force[simulation.base_motor] / max(1, measured.steps)
        rotation = Rotation.from_quat(simulation.data.mocap_quat[0], scalar_first=True)
        return np.concatenate([rotation.apply(mean[:3]), rotation.apply(mean[3:])])

    def _state(self) -> Float[np.ndarray, " state"]:
        state = np.zeros(mujoco.mj_stateSize(self.simulation.model, STATE))
        mujoco.mj_getState(self.simulation.model, self.simulation.data, state, STATE)
        return state


class _Measured:
    """What is summed over the steps between two records."""

    def __init__(self, simulation: SimulationModel) -> None:
        self._simulation = simulation
        self.steps, self.deepest = 0, 0.0
        self.link_force = np.zeros(len(simulation.link_body))
        self.motor_force, self.greatest = np.zeros((2, simulation.model.nu))

    def add(self) -> None:
        """Add the step that was just made, whose contacts and forces the model's data still holds."""
        simulation, data = self._simulation, self._simulation.data
        self.steps += 1
        self.motor_force += data.actuator_force
        np.maximum(self.greatest, np.abs(data.actuator_force), out=self.greatest)
        if data.ncon == 0:
            return
        depth = -np.asarray(data.contact.dist)[pair_sides(simulation) == HAND_SIDE + ENVIRONMENT_SIDE]
        self.deepest = max(self.deepest, float(depth.max(initial=0.0)))
        self.link_force += link_forces(simulation)


def hand_clearance(simulation: SimulationModel) -> float:
    """Return the least distance of the hand's and the surroundings' pieces [m], at most FAR; negative: penetration."""
    model, data, least = simulation.model, simulation.data, FAR
    hands, others = (np.flatnonzero(simulation.side == side) for side in (HAND_SIDE, ENVIRONMENT_SIDE))
    # Surroundings may have thousands of pieces, most of them far away: balls around both are apart by at least this.
    apart = np.linalg.norm(data.geom_xpos[hands, None] - data.geom_xpos[others], axis=2)
    apart -= model.geom_rbound[hands, None] + model.geom_rbound[others]
    for hand, other in zip(*np.nonzero(apart < FAR), strict=True):
        if apart[hand, other] < least:
            distance = mujoco.mj_geomDistance(model, data, int(hands[hand]), int(others[other]), least, None)
            least = min(least, distance)
    return float(least)
