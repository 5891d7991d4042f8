"""Where a hand's coordinates stand in a compiled MuJoCo model, and what is done with them there."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Int

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts


@dataclass(frozen=True)
class HandIndices:
    """Entries of a model that holds what `mjcf_of_hand` wrote.

    link_body: body of each link. joint_position: entry in qpos of the joint that carries each link, -1 where it is fixed.
    dof_of_angle: velocity of every degree of freedom for unit velocity of a joint angle of q. motor_of_angle: length of
    every motor for unit joint angle; a motor whose tendon two joints share has two ones.
    """

    link_body: Int[np.ndarray, " link"]
    joint_position: Int[np.ndarray, " link"]
    dof_of_angle: Float[np.ndarray, "dof angle"]
    motor_of_angle: Float[np.ndarray, "motor angle"]

    @property
    def angle_of_motor(self) -> Float[np.ndarray, "angle motor"]:
        """Joint angles for unit length of a motor: the joints of a shared tendon move alike."""
        return self.motor_of_angle.T / np.maximum(self.motor_of_angle.sum(axis=1), 1.0)

    def place_joints(self, hand: Hand, data: Any, joint_angles: Float[np.ndarray, " angle"]) -> None:
        """Put the joints of `hand` at these angles [rad] in MuJoCo's `data`, and the motors' targets there."""
        for link, joint in enumerate(hand.joints):
            if joint is not None and joint.index is not None:
                data.qpos[self.joint_position[link]] = joint.multiplier * joint_angles[joint.index] + joint.offset
        data.ctrl[:] = self.motor_of_angle @ joint_angles

    def point_jacobian(self, model: Any, data: Any, point: np.ndarray, link: int) -> Float[np.ndarray, "3 angle"]:
        """d point / d joint angles [m/rad] of a point [m, world] that is fixed to a link, with the palm fixed."""
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, int(self.link_body[link]))
        return np.asarray(jacobian @ self.dof_of_angle)

    def contact_jacobians(self, model: Any, data: Any, contacts: HandContacts) -> Float[np.ndarray, "contact 3 angle"]:
        """The same of the points of the hand at the contacts."""
        found = np.zeros((len(contacts.points), 3, self.dof_of_angle.shape[1]))
        for index, (point, link) in enumerate(zip(contacts.points, contacts.link, strict=True)):
            found[index] = self.point_jacobian(model, data, point, int(link))
        return found


def hand_indices(hand: Hand, model: Any) -> HandIndices:
    """The indices of `hand` in the compiled `model`."""
    joint_position = np.full(len(hand.link_names), -1)
    dof_of_angle = np.zeros((model.nv, hand.num_joints))
    for link, joint in enumerate(hand.joints):
        if joint is not None and joint.index is not None:
            joint_position[link] = model.joint(joint.name).qposadr[0]
            dof_of_angle[model.joint(joint.name).dofadr[0], joint.index] = joint.multiplier
    motor_of_angle = np.zeros((model.nu, hand.num_joints))
    coupled = {name for pair in hand.couplings for name in pair}
    for index, name in enumerate(hand.joint_names):
        if name not in coupled:
            motor_of_angle[model.actuator(name).id, index] = 1.0
    for (follower, leader), pair in zip(hand.couplings, hand.coupled_indices, strict=True):
        motor_of_angle[model.actuator(f"{follower}+{leader}").id, pair] = 1.0
    bodies = np.asarray([model.body(name).id for name in hand.link_names])
    return HandIndices(bodies, joint_position, dof_of_angle, motor_of_angle)
