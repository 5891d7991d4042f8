"""A home for an arm whose description names none."""

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import Arm
from dexnudge.arms.inverse_kinematics import InverseKinematics

AHEAD, UP = 0.45, 0.35  # of the reach: where the flange is, seen from the base
STARTS = 12


def home_in_front(arm: Arm) -> Float[np.ndarray, " n"]:
    """Return joint angles at which the flange faces down in front of the base, its joints as high as they may be.

    The middle of the limits, with joints at zero where that is within them, if no such angles are found.
    """
    limits = arm.limits
    straight = np.clip(0.0, limits.lower, limits.upper)
    target = np.diag([1.0, -1.0, -1.0, 1.0])
    target[:3, 3] = [AHEAD * arm.reach, 0.0, UP * arm.reach]
    solver, generator = InverseKinematics(arm), np.random.default_rng(0)
    starts = [straight, *generator.uniform(limits.lower, limits.upper, (STARTS, arm.num_joints))]
    found = [home for start in starts if (home := solver.solve(arm.T_world_base @ target, start)) is not None]
    turned = [_near_zero(home, arm) for home in found]
    return max(turned, key=lambda home: _worth(home, arm)) if turned else straight


def _near_zero(position: Float[np.ndarray, " n"], arm: Arm) -> Float[np.ndarray, " n"]:
    """Return the same pose with joints that turn farther than half a turn turned back, where their limits allow it."""
    turns = np.array([not joint.slides for joint in arm.chain if joint.name in arm.joint_names])
    nearer = np.where(turns, (position + np.pi) % (2 * np.pi) - np.pi, position)
    allowed = (nearer >= arm.limits.lower) & (nearer <= arm.limits.upper)
    return np.where(allowed, nearer, position)


def _worth(position: Float[np.ndarray, " n"], arm: Arm) -> float:
    """Return how high the joints stand, in reaches, less a tenth of how far they turn [rad]."""
    poses = arm.link_poses(position)
    heights = [poses[joint.child][2, 3] for joint in arm.chain]
    return float(np.mean(heights) / arm.reach - 0.1 * np.abs(position).mean())
