"""What is recorded of a simulation, 20 ms apart."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Int

from dexnudge.simulation.push_model import ENVIRONMENT_SIDE, HAND_SIDE, OBJECT_SIDE, PushModel

FAR = 0.05  # [m] clearances above this are not told apart


def pair_sides(push: PushModel) -> Int[np.ndarray, " contact"]:
    """The two sides of each current contact, as the sum of their bits."""
    geoms = np.asarray(push.data.contact.geom).reshape(-1, 2)
    return np.asarray(push.side[geoms].sum(axis=1))


def hand_in_environment(push: PushModel) -> float:
    """Greatest depth of the hand in the surroundings by MuJoCo's contacts [m], 0 where there is none."""
    if push.data.ncon == 0:
        return 0.0
    distance = np.asarray(push.data.contact.dist)[pair_sides(push) == HAND_SIDE + ENVIRONMENT_SIDE]
    return max(0.0, -float(distance.min(initial=0.0)))


def contact_force_sums(push: PushModel, one: int, other: int) -> Float[np.ndarray, " 2"]:
    """Sums over the contacts between two sides of (normal force, size of the tangential force) [N]."""
    sums, force = np.zeros(2), np.zeros(6)
    if push.data.ncon:
        for index in np.flatnonzero(pair_sides(push) == one + other):
            mujoco.mj_contactForce(push.model, push.data, int(index), force)
            sums += force[0], np.hypot(force[1], force[2])
    return sums


def hand_object_forces(push: PushModel) -> Float[np.ndarray, " 2"]:
    """`contact_force_sums` of hand and object."""
    return contact_force_sums(push, HAND_SIDE, OBJECT_SIDE)


def hand_clearance(push: PushModel) -> float:
    """Least distance between the hand's and the surroundings' convex pieces [m], at most FAR; negative: penetration."""
    least = FAR
    for hand in np.flatnonzero(push.side == HAND_SIDE):
        for other in np.flatnonzero(push.side == ENVIRONMENT_SIDE):
            least = min(least, mujoco.mj_geomDistance(push.model, push.data, int(hand), int(other), least, None))
    return float(least)


@dataclass(frozen=True, kw_only=True)
class Records:
    """Records of hand and object.

    Attributes:
        time [s].
        qpos, ctrl, mocap: MuJoCo's coordinates, motor targets, and target of the base (position, quaternion wxyz).
        object_pose: centre of mass [m, world], quaternion wxyz of the object's frame.
        base_pose: of the palm, position [m] and quaternion wxyz.
        hand_object_force: sums of the normal and of the tangential forces of hand on object [N].
        hand_environment_clearance: [m] between convex pieces, at most 50 mm, negative where they penetrate.
        hand_environment_depth: greatest depth by MuJoCo's contacts at any step since the record before [m].
    """

    time: Float[np.ndarray, " record"]
    qpos: Float[np.ndarray, "record nq"]
    ctrl: Float[np.ndarray, "record nu"]
    mocap: Float[np.ndarray, "record 7"]
    object_pose: Float[np.ndarray, "record 7"]
    base_pose: Float[np.ndarray, "record 7"]
    hand_object_force: Float[np.ndarray, "record 2"]
    hand_environment_clearance: Float[np.ndarray, " record"]
    hand_environment_depth: Float[np.ndarray, " record"]


def record_now(push: PushModel, deepest: float) -> dict[str, Any]:
    """One record of the state that `push.data` is in, by the names in `Records`; deepest: its hand_environment_depth [m]."""
    data, palm, free = push.data, push.palm_position, push.object_position
    return {
        "time": data.time,
        "qpos": np.array(data.qpos),
        "ctrl": np.array(data.ctrl),
        "mocap": np.concatenate([data.mocap_pos[0], data.mocap_quat[0]]),
        "object_pose": np.concatenate([data.xipos[push.object_body], data.qpos[free + 3 : free + 7]]),
        "base_pose": np.array(data.qpos[palm : palm + 7]),
        "hand_object_force": hand_object_forces(push),
        "hand_environment_clearance": hand_clearance(push),
        "hand_environment_depth": deepest,
    }
