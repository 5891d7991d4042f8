"""Where a hand's coordinates stand in a compiled MuJoCo model."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dexnudge.hands.hand import Hand


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
