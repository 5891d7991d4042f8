"""What can be read off a simulated push at one moment: forces between hand and object, and the hand's room."""

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
