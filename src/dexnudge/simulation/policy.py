"""What decides, step by step, what base and fingers are told while they push: from what a robot senses to a command."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError, is_name, quote
from dexnudge.simulation.contact_forces import link_forces
from dexnudge.simulation.hand_path import PushPath
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.push_forces import PushForces

LARGEST = 1e6  # number that may be commanded: no length, torque or target of a hand is beyond it
SHORTEST = 1e-6  # quaternion that still has a direction


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What a robot senses at one step.

    Attributes:
        time: since the simulation began [s].
        joint_angles: in the order of `joint_names` [rad, m of sliding ones].
        motor_torque: of the fingers' motors [N m, N of sliding ones]; entries of the base's motors are zero.
        T_world_palm: pose of the palm, from the arm's joints.
        base_wrench: force [N] and torque about the palm's origin [N m] with which the arm acts on the palm, world.
        link_force: normal force of each link on the object [N], as skin on the links feels it.
        T_world_object: pose of the object, as cameras see it; None for a robot that does not see it.
    """

    time: float
    joint_angles: Float[np.ndarray, " joint"]
    motor_torque: Float[np.ndarray, " motor"]
    T_world_palm: Float[np.ndarray, "4 4"]
    base_wrench: Float[np.ndarray, " 6"]
    link_force: Float[np.ndarray, " link"]
    T_world_object: Float[np.ndarray, "4 4"] | None


class Command(NamedTuple):
    """What hand and fingers are told for one step.

    q: configuration (world), whose first three are the target of the base. quaternion: of that target, wxyz. ctrl: of all
    motors, those of the base included. phase: its name.
    """

    q: Float[np.ndarray, " coordinates"]
    quaternion: Float[np.ndarray, " 4"]
    ctrl: Float[np.ndarray, " motor"]
    phase: str


@dataclass(frozen=True)
class HandDrive:
    """Motors of fingers and base; see `SimulationModel` for all but `lower` and `upper`, the range of their targets."""

    motor_of_angle: Float[np.ndarray, "motor angle"]
    motor_gain: Float[np.ndarray, " motor"]
    base_motor: Int[np.ndarray, " base"]
    base_stiffness: Float[np.ndarray, " base"]
    base_damping: Float[np.ndarray, " base"]
    lower: Float[np.ndarray, " motor"]
    upper: Float[np.ndarray, " motor"]

    @classmethod
    def of(cls, simulation: SimulationModel) -> "HandDrive":
        """Return the motors of a model."""
        model = simulation.model
        lower, upper = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
        names = ("motor_of_angle", "motor_gain", "base_motor", "base_stiffness", "base_damping")
        return cls(**{name: getattr(simulation, name) for name in names}, lower=lower, upper=upper)


@dataclass(frozen=True)
class PushPlan:
    """What a policy is to carry out.

    path: where base, fingers and object should be at every step. forces: with which the hand should press. drive: the
    motors.
    """

    path: PushPath
    forces: PushForces
    drive: HandDrive


@runtime_checkable
class Policy(Protocol):
    """Decides what base and fingers are told at every step of a push."""

    def start(self, plan: PushPlan) -> None:
        """Begin a push; nothing may be left from the one before."""

    def command(self, seen: Observation) -> Command | None:
        """Return what to do in the next step, or None when the push is over."""


def check_command(command: object, policy: Policy, *, coordinates: int, motors: int) -> None:
    """Refuse what is no command of finite numbers to a hand of so many coordinates and motors; InputError."""
    who = f"the policy {type(policy).__name__}"
    if not isinstance(command, Command):
        raise InputError(f"{who} commanded {quote(command)}; expected a Command, or None when the push is over")
    for name, size in (("q", coordinates), ("quaternion", 4), ("ctrl", motors)):
        value = getattr(command, name)
        if not isinstance(value, np.ndarray) or value.shape != (size,) or value.dtype.kind not in "fiu":
            got = f"{value.dtype} of shape {value.shape}" if isinstance(value, np.ndarray) else quote(value)
            raise InputError(f"{who} commanded a `{name}` that is {got}; expected an array of {size} numbers")
        if not (np.abs(value) <= LARGEST).all():  # nor is NaN
            raise InputError(f"{who} commanded a `{name}` beyond {LARGEST:g}, or NaN; expected {size} finite numbers")
    if np.linalg.norm(command.quaternion) < SHORTEST:
        raise InputError(f"{who} commanded a `quaternion` of length 0; expected one of length 1")
    if not is_name(command.phase):
        raise InputError(f"{who} commanded the `phase` {quote(command.phase)}; expected its name")


class Senses:
    """Observes a simulation as a robot would; `sees`: whether it has the object's pose."""

    def __init__(self, simulation: SimulationModel, *, sees: bool = True) -> None:
        self._simulation, self._sees = simulation, sees
        self._angle = [int(simulation.model.joint(name).qposadr[0]) for name in simulation.hand.joint_names]

    def observe(self) -> Observation:
        """Return what is sensed now."""
        simulation, data, palm = self._simulation, self._simulation.data, self._simulation.palm_position
        base = simulation.base_motor
        torque, force = np.array(data.actuator_force), np.array(data.actuator_force[base])
        torque[base] = 0.0
        pose, target = np.eye(4), Rotation.from_quat(data.mocap_quat[0], scalar_first=True).as_matrix()
        pose[:3, :3] = Rotation.from_quat(data.qpos[palm + 3 : palm + 7], scalar_first=True).as_matrix()
        pose[:3, 3] = data.qpos[palm : palm + 3]
        return Observation(
            time=data.time,
            joint_angles=data.qpos[self._angle],
            motor_torque=torque,
            T_world_palm=pose,
            base_wrench=np.concatenate([target @ force[:3], target @ force[3:]]),
            link_force=link_forces(simulation),
            T_world_object=simulation.object_poses(data.qpos[None])[0] if self._sees else None,
        )
