"""What hand and arm do while they press on an object and carry it along: where they go, and the efforts with which."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.object_path import push_length, supports_of_way
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import interpolated
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.push_forces import LEAST_FORCE, PushForces, push_forces
from dexnudge.verification.verdicts import contacts_of


@dataclass(frozen=True)
class Press:
    """A push of one configuration, for arm and hand.

    Attributes:
        contact: q of the hand where the approach ends (world), at rest.
        touching: q of the hand once fingers and palm have closed until the links that press touch; of the squeeze the end.
        motion: unit, world. length: of the push [m].
        forces: with which the hand presses along the push, and by how much it closes.
        finger_effort: [N m] per joint of the hand at the places of `forces`.
        link_force: greatest normal force of each link on the object [N].
    """

    contact: Float[np.ndarray, " coordinates"]
    touching: Float[np.ndarray, " coordinates"]
    motion: Float[np.ndarray, " 3"]
    length: float
    forces: PushForces
    finger_effort: Float[np.ndarray, "place d"]
    link_force: dict[str, float]

    def carried(self, travelled: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k coordinates"]:
        """Return q of the hand once it has carried the object by these lengths [m]."""
        q = np.tile(self.touching, (len(travelled), 1))
        q[:, :3] += np.outer(travelled, self.motion)
        return q

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
        wrench = interpolated(done, places, self.forces.base_wrench)
        fingers = interpolated(done, places, self.finger_effort)
        jacobians = palm_jacobians(robot, positions, q[:, :3])
        return np.asarray(
            loaded[:, None] * np.concatenate([np.einsum("kxj,kx->kj", jacobians, wrench), fingers], axis=1)
        )


def press(
    simulation: SimulationModel, scene: Scene, q: Float[np.ndarray, " coordinates"], *, length: float | None = None
) -> Press:
    """Return the push of one configuration.

    Args:
        simulation: `scene_model` of the hand in the scene, of which closing and levers are read; q is placed in it.
        scene: the scene, the object where it lies before the push.
        q: configuration of the hand at contact (world).
        length: of the push [m]; None: that of the scene.
    """
    hand, task = simulation.hand, sliding_task(scene)
    q = np.asarray(q, dtype=np.float64)
    length = push_length(scene) if length is None else length
    (contacts,) = contacts_of(scene, hand, q[None])
    forces = push_forces(simulation, q, contacts, supports_of_way(scene, length), task)
    touching = q.copy()
    touching[:3] += forces.base_closing
    touching[ROOT_COORDINATES:] += simulation.angle_of_motor @ forces.closing
    normal = -np.einsum("pcx,cx->pc", forces.force, contacts.normals)
    link_force = {
        hand.link_names[link]: float(normal[:, contacts.link == link].sum(axis=1).max())
        for link in np.unique(contacts.link)
    }
    return Press(
        contact=q,
        touching=hand.clamp(torch.as_tensor(touching)[None])[0].numpy(),
        motion=task.motion,
        length=length,
        forces=forces,
        finger_effort=forces.motor_torque @ (simulation.motor_of_angle > 0),
        link_force={name: force for name, force in link_force.items() if force > LEAST_FORCE},
    )


def palm_jacobians(
    robot: Robot, positions: Float[np.ndarray, "k n"], points: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 6 arm"]:
    """Return the Jacobians of points [m, world] that go with the palm, by the arm's joints.

    Linear [m/rad] then angular [rad/rad], world; of joints that slide per metre.
    """
    body = robot.body
    T_world_link = body.forward_kinematics(torch.as_tensor(robot.coordinates(positions))).numpy()
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
