"""What moves the joints: motors that hold them at a position, as stiff, strong and fast as these are.

A motor's force is kp (target - position) - kv velocity, at most its effort either way.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import Hand

JOINT_EFFORT = 2.0  # [N m] Shadow Robot's published URDF
JOINT_VELOCITY = 2.0  # [rad/s] Shadow Robot's published URDF
JOINT_DAMPING = 0.1  # [N m s/rad] the Shadow model in gymnasium-robotics
JOINT_ARMATURE = 0.001  # [kg m^2] the Shadow model in gymnasium-robotics
POSITION_GAIN = 5.0  # [N m/rad] 5 N at a fingertip 0.1 m away for an error of 0.1 rad
# Of a sliding joint all of these are those of a lever as long as its scale s: effort / s, velocity * s, the others / s^2.


@dataclass(frozen=True)
class JointDrives:
    """What drives d joints; of a joint that slides metres stand for radians, newtons for newton metres.

    effort [N m], velocity [rad/s]: the most of either sign. kp [N m/rad], kv [N m s/rad]: the motors' gains.
    damping [N m s/rad], armature [kg m^2]: of the joints.
    """

    effort: Float[np.ndarray, " d"]
    velocity: Float[np.ndarray, " d"]
    kp: Float[np.ndarray, " d"]
    kv: Float[np.ndarray, " d"]
    damping: Float[np.ndarray, " d"]
    armature: Float[np.ndarray, " d"]


def nominal_drives(hand: Hand) -> JointDrives:
    """Return nominal values, not the real hand's; what damps the joints is their friction and no motor."""
    scale = hand.joint_scales
    return JointDrives(
        effort=JOINT_EFFORT / scale,
        velocity=JOINT_VELOCITY * scale,
        kp=POSITION_GAIN / scale**2,
        kv=np.zeros(hand.num_joints),
        damping=JOINT_DAMPING / scale**2,
        armature=JOINT_ARMATURE / scale**2,
    )


@dataclass(frozen=True)
class Actuator:
    """A motor.

    name: the joint's, or "FOLLOWER+LEADER" of two joints on one tendon. joints: joint -> how far the motor moves for a unit
    of the joint; its position is the sum over them. lower, upper: of its position. kp, effort: see `JointDrives`. kv: force
    for unit velocity, by which motor and joints are damped; own_kv: the motor's part of it.
    """

    name: str
    joints: dict[str, float]
    lower: float
    upper: float
    kp: float
    kv: float
    own_kv: float
    effort: float


def actuators(hand: Hand, drives: JointDrives) -> list[Actuator]:
    """Return the motors: one for each joint of its own, then one for each tendon that two joints share."""
    coupled = {name for pair in hand.couplings for name in pair}
    own = [([name], [index]) for index, name in enumerate(hand.joint_names) if name not in coupled]
    shared = [(list(names), pair.tolist()) for names, pair in zip(hand.couplings, hand.coupled_indices, strict=True)]
    return [
        Actuator(
            name="+".join(names),
            joints=dict.fromkeys(names, 1.0),
            lower=float(hand.lower[indices].sum()),
            upper=float(hand.upper[indices].sum()),
            kp=float(drives.kp[indices[0]]),
            kv=float((drives.kv + drives.damping / len(indices))[indices[0]]),  # joints on a tendon share the velocity
            own_kv=float(drives.kv[indices[0]]),
            effort=float(drives.effort[indices[0]]),
        )
        for names, indices in [*own, *shared]
    ]
