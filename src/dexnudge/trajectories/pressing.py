"""What hand and arm do while they press on an object and carry it along: where they go, and the efforts with which."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from dexnudge.arms.robot import Robot
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.object_path import stations
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import PUSH, SQUEEZE, STOP, interpolated, orthonormal, push_path
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.push_forces import LEAST_FORCE, push_forces
from dexnudge.simulation.rollout import Rollout
from dexnudge.simulation.success import PushVerdict, judge_push
from dexnudge.verification.penetration import PenetrationCheck
from dexnudge.verification.verdicts import contacts_of

GIVING_WAY = (1.0, 0.5, 0.0)  # of what fingers gave way by in a rehearsal; where that is not clean, less is planned
DEEPEST = 0.0009  # [m] of the hand in object, surroundings or itself: nearly what a configuration may have
CLOSING_LOOKS = 5  # places from contact to where the hand presses at which depths are looked at


@dataclass(frozen=True)
class Press:
    """A push of one configuration, for arm and hand; from a rehearsal in which a compliant arm carries the hand.

    Fingers give way under load, those on shared tendons until they are at their stops, and the palm follows them by some
    millimetres. So where hand and arm go, and what they press with, is what the rehearsal has come to.

    Attributes:
        contact: q of the hand where the approach ends (world), at rest.
        pressing: q of the hand at places evenly spread over the push, both ends included (world).
        finger_effort: [N m] per joint of the hand at these places.
        palm_wrench: force [N] and torque about the palm's origin [N m] of the arm on the hand at these places, world.
        motion: unit, world. length: of the push [m].
        link_force: greatest normal force of each link on the object [N].
        verdict: on the rehearsal.
    """

    contact: Float[np.ndarray, " coordinates"]
    pressing: Float[np.ndarray, "place coordinates"]
    finger_effort: Float[np.ndarray, "place d"]
    palm_wrench: Float[np.ndarray, "place 6"]
    motion: Float[np.ndarray, " 3"]
    length: float
    link_force: dict[str, float]
    verdict: PushVerdict

    @property
    def touching(self) -> Float[np.ndarray, " coordinates"]:
        """Q of the hand at the end of the squeeze (world)."""
        return self.pressing[0]

    def carried(self, travelled: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k coordinates"]:
        """Return q of the hand once it has carried the object by these lengths [m]."""
        places = np.linspace(0.0, self.length, len(self.pressing))
        along = np.outer(places, np.concatenate([self.motion, np.zeros(len(self.contact) - 3)]))
        q = CubicSpline(places, self.pressing - along)(travelled)
        q[:, :3] += np.outer(travelled, self.motion)
        return orthonormal(q)

    def nearer_contact(self, share: float) -> "Press":
        """Return the same push with the hand nearer to how it was at contact: 1 leaves it, with 0 nothing gives way."""
        rigid = np.tile(self.contact, (len(self.pressing), 1))
        rigid[:, :3] += np.outer(np.linspace(0.0, self.length, len(rigid)), self.motion)
        return replace(self, pressing=orthonormal(rigid + share * (self.pressing - rigid)))

    def depth(self, hand: Hand, scene: Scene) -> float:
        """Return how deep the hand gets into object, surroundings or itself from contact to the end of the push [m]."""
        closing = self.contact + np.linspace(0.0, 1.0, CLOSING_LOOKS)[:, None] * (self.touching - self.contact)
        done = np.concatenate([np.zeros(CLOSING_LOOKS), np.linspace(0.0, self.length, len(self.pressing))])
        return deepest(hand, scene, np.concatenate([closing, self.pressing]), done[:, None] * self.motion)

    def efforts(
        self, robot: Robot, positions: Float[np.ndarray, "k n"], loaded: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, "k n"]:
        """Return the effort of every joint of arm and hand [N m] at positions of squeeze and push.

        Joint efforts J^T f that hold the hand's forces on the object; `loaded` is the share of them, from 0 to 1. How far
        the object is carried follows from where the palm is.
        """
        q = robot.configurations(positions)
        done = np.clip((q[:, :3] - self.touching[:3]) @ self.motion / self.length, 0.0, 1.0)
        places = np.linspace(0.0, 1.0, len(self.finger_effort))
        wrench = interpolated(done, places, self.palm_wrench)
        fingers = interpolated(done, places, self.finger_effort)
        jacobians = palm_jacobians(robot, positions, q[:, :3])
        return np.asarray(
            loaded[:, None] * np.concatenate([np.einsum("kxj,kx->kj", jacobians, wrench), fingers], axis=1)
        )


def deepest(
    hand: Hand, scene: Scene, q: Float[np.ndarray, "k coordinates"], carried: Float[np.ndarray, "k 3"]
) -> float:
    """Return how deep the hand gets into itself, the surroundings, or the object that it has `carried` so far [m]."""
    T_world_link = hand.forward_kinematics(torch.as_tensor(q)).numpy()
    T_of_object = T_world_link.copy()
    T_of_object[:, :, :3, 3] -= carried[:, None]
    check = PenetrationCheck(hand, scene)
    found = check.in_object(T_of_object)[0], check.in_environment(T_world_link), check.in_itself(T_world_link)
    return float(max(each.max() for each in found))


def press(simulation: SimulationModel, scene: Scene, q: Float[np.ndarray, " coordinates"], *, length: float) -> Press:
    """Return the push of one configuration.

    Args:
        simulation: `scene_model` of the hand in the scene, of which closing and levers are read; q is placed in it.
        scene: the scene, the object where it lies before the push.
        q: configuration of the hand at contact (world).
        length: of the push [m].
    """
    hand, task = simulation.hand, sliding_task(scene)
    q = np.asarray(q, dtype=np.float64)
    (contacts,) = contacts_of(scene, hand, q[None])
    forces = push_forces(simulation, q, contacts, stations(scene, length), task)
    normal = -np.einsum("pcx,cx->pc", forces.force, contacts.normals)
    link_force = {
        hand.link_names[link]: float(normal[:, contacts.link == link].sum(axis=1).max())
        for link in np.unique(contacts.link)
    }
    rehearsal = Rollout(simulation, q)
    rehearsal.push(push_path(np.zeros(1), q[None], motion=scene.object_motion, length=length), forces)
    pressing, motor_force, wrench = _pressed(rehearsal, np.linspace(0.0, length, len(forces.force)), scene.motion)
    return Press(
        contact=q,
        pressing=pressing,
        finger_effort=motor_force @ (simulation.motor_of_angle > 0),
        palm_wrench=wrench,
        motion=scene.motion,
        length=length,
        link_force={name: force for name, force in link_force.items() if force > LEAST_FORCE},
        verdict=judge_push(
            rehearsal.trace,
            motion=scene.object_motion,
            length=length,
            max_normal_force=task.max_normal_force,
            diverged=rehearsal.divergence is not None,
        ),
    )


def _pressed(
    rollout: Rollout, travelled: Float[np.ndarray, " place"], motion: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, "place coordinates"], Float[np.ndarray, "place motor"], Float[np.ndarray, "place 6"]]:
    """Return q, the motors' forces and the wrench on the palm (world) where the hand of a push was told to be.

    Means over neighbouring records, so that what the object's sticking and slipping does in between is left out.
    """
    simulation, trace = rollout.simulation, rollout.trace
    kept = np.flatnonzero(np.isin(trace.phase, (SQUEEZE, PUSH, STOP)))
    kept = kept[np.searchsorted(kept, np.flatnonzero(trace.phase == SQUEEZE)[-1]) :]
    done = (trace.mocap[kept, :3] - trace.mocap[kept[0], :3]) @ motion
    q = simulation.configurations(trace.qpos[kept])
    q[:, :3] += np.outer(-done, motion)
    rows = [q, trace.motor_force[kept], trace.base_wrench[kept]]
    half = travelled[1] / 2
    near = np.abs(done - travelled[:, None]) <= half
    found, force, wrench = (np.stack([each[mine].mean(axis=0) for mine in near]) for each in rows)
    found[:, :3] += np.outer(travelled, motion)
    return simulation.hand.clamp(torch.as_tensor(orthonormal(found))).numpy(), force, wrench


def palm_jacobians(
    robot: Robot, positions: Float[np.ndarray, "k n"], points: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 6 arm"]:
    """Return the Jacobians of points [m, world] that go with the palm, by the arm's joints.

    Linear [m/rad] then angular [rad/rad], world; of joints that slide per metre.
    """
    body = robot.body
    T_world_link = robot.link_poses(positions)
    jacobians = np.zeros((len(positions), 6, robot.arm.num_joints))
    for link, joint in enumerate(body.joints):
        if joint is None or joint.index is None or joint.index >= robot.arm.num_joints:
            continue
        axis = joint.multiplier * T_world_link[:, link, :3, :3] @ joint.axis
        if joint.slides:
            jacobians[:, :3, joint.index] += axis
        else:
            jacobians[:, :3, joint.index] += np.cross(axis, points - T_world_link[:, link, :3, 3])
            jacobians[:, 3:, joint.index] += axis
    return jacobians
