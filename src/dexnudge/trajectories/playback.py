"""A plan played in MuJoCo by the motors of arm and hand alone: every joint is told where to be and what to add."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from dexnudge.arms.export import robot_actuators
from dexnudge.hands.motors import Actuator
from dexnudge.simulation.hand_path import interpolated
from dexnudge.simulation.model import TIMESTEP
from dexnudge.simulation.policy import Command
from dexnudge.simulation.robot_model import RobotModel
from dexnudge.simulation.rollout import Rollout, Trace
from dexnudge.trajectories.interpolation import at
from dexnudge.trajectories.plan import Plan


@dataclass(frozen=True, kw_only=True)
class PlanTrace(Trace):
    """Records of arm, hand and object, 20 ms apart; what is said of the hand holds for arm and hand.

    Attributes:
        planned: position of every joint in the plan at that time [rad].
        tracking_error: by how much the joints are ahead of it [rad]; the delay of the motors is part of it.
        palm_error: of the palm's place [m] and orientation [rad] against the plan's.
        velocity: of every joint [rad/s].
    """

    planned: Float[np.ndarray, "record n"]
    tracking_error: Float[np.ndarray, "record n"]
    palm_error: Float[np.ndarray, "record 2"]
    velocity: Float[np.ndarray, "record n"]


def set_points(
    motors: Sequence[Actuator],
    names: Sequence[str],
    position: Float[np.ndarray, "k n"],
    velocity: Float[np.ndarray, "k n"],
    effort: Float[np.ndarray, "k n"],
) -> Float[np.ndarray, "k motor"]:
    """Return ctrl of every motor [rad] for position [rad], velocity [rad/s] and effort [N m] of the joints `names`.

    ctrl = position + (kv velocity + effort) / kp. Two joints on one tendon share a motor: its position and velocity are
    their sum, and its force, which turns both alike, the mean of their efforts.
    """
    motor_of_joint = np.array([[motor.joints.get(name, 0.0) for name in names] for motor in motors])
    kp, kv = (np.array([getattr(motor, gain) for motor in motors]) for gain in ("kp", "kv"))
    share = motor_of_joint / (motor_of_joint**2).sum(axis=1, keepdims=True)
    return np.asarray(position @ motor_of_joint.T + (kv * (velocity @ motor_of_joint.T) + effort @ share.T) / kp)


class PlanRollout(Rollout):
    """A simulation of a robot that plays plans one after another; nothing but the motors moves arm and hand.

    At every step of 2 ms the motors get the set points of the time before it.

    model: of robot and scene. position: of the robot's joints at first [rad].
    """

    def __init__(self, model: RobotModel, position: Float[np.ndarray, " n"]) -> None:
        super().__init__(model.simulation, model.robot.coordinates(position[None])[0])
        self._model, self._motors = model, robot_actuators(model.robot)
        self._more: dict[str, list] = {name: [] for name in ("planned", "velocity")}
        self._planned = np.array(position)

    def follow_plan(self, plan: Plan) -> None:
        """Play a plan from where the robot is, which should be where the plan begins."""
        if not self._columns["time"]:
            self._record(plan.phases[0].name)
        self.play(self._plan_commands(plan))

    def _plan_commands(self, plan: Plan) -> Iterator[Command]:
        trajectory, names = plan.trajectory, plan.robot.joint_names
        steps = round(trajectory.duration / TIMESTEP)
        time = trajectory.time[0] + TIMESTEP * np.arange(steps + 1)
        joints, effort = at(trajectory, time), interpolated(time, trajectory.time, trajectory.effort)
        ctrl = set_points(self._motors, names, joints.position, joints.velocity, effort)
        q = plan.robot.coordinates(joints.position)
        ends = np.array([phase.end for phase in plan.phases[:-1]])
        phase = np.searchsorted(ends, time[1:] - TIMESTEP / 2)
        base = self.simulation.model.body(int(self.simulation.link_body[0])).quat
        for step in range(steps):
            self._planned = joints.position[step + 1]
            yield Command(q[step], base, ctrl[step], plan.phases[phase[step]].name)

    @property
    def plan_trace(self) -> PlanTrace:
        """All records so far."""
        whole = self.trace
        more = {name: np.array(values) for name, values in self._more.items()}
        positions = self._model.positions(whole.qpos)
        poses, planned = (self._model.robot.palm_poses(each) for each in (positions, more["planned"]))
        wrench = whole.base_wrench  # about the world's origin, as yet
        wrench[:, 3:] -= np.cross(poses[:, :3, 3], wrench[:, :3])
        off = np.linalg.norm(poses[:, :3, 3] - planned[:, :3, 3], axis=1)
        cosine = (np.einsum("kxy,kxy->k", poses[:, :3, :3], planned[:, :3, :3]) - 1) / 2
        return PlanTrace(
            **vars(whole),
            **more,
            tracking_error=positions - more["planned"],
            palm_error=np.stack([off, np.arccos(np.clip(cosine, -1.0, 1.0))], axis=1),
        )

    def _record(self, phase: str) -> None:
        super()._record(phase)
        model, data = self.simulation.model, self.simulation.data
        velocity = data.qvel[[model.joint(name).dofadr[0] for name in self._model.robot.joint_names]]
        for name, value in {"planned": self._planned, "velocity": velocity}.items():
            self._more[name].append(np.array(value))

    def _base_wrench(self) -> Float[np.ndarray, " 6"]:
        """Return what balances the contacts of the hand's links now; the torque about the world's origin."""
        model, data, names = self.simulation.model, self.simulation.data, self._model.robot.hand.link_names
        mujoco.mj_rnePostConstraint(model, data)
        links = [model.body(name).id for name in names]
        torque, force = -data.cfrc_ext[links].sum(axis=0).reshape(2, 3)
        return np.concatenate([force, torque + np.cross(data.subtree_com[model.body_rootid[links[0]]], force)])
