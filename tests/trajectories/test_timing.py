"""Trajectories stay within limits, near their way, and are about as fast as ruckig's."""

import numpy as np
import pytest
from ruckig import InputParameter, Ruckig, Trajectory

from dexnudge.arms.arm import JointLimits
from dexnudge.arms.named.panda import LIMITS
from dexnudge.trajectories.limits import limits_used
from dexnudge.trajectories.timing import time_optimal


@pytest.mark.parametrize("distance", [0.05, 0.5, 2.0])
def test_a_straight_motion_takes_little_longer_than_ruckig_s(distance):
    path = np.stack([np.zeros(7), np.r_[distance, np.zeros(6)]])
    wanted, found = InputParameter(1), Trajectory(1)
    wanted.target_position = [distance]
    wanted.max_velocity, wanted.max_acceleration = [LIMITS.velocity[0]], [LIMITS.acceleration[0]]
    wanted.max_jerk = [LIMITS.jerk[0]]
    Ruckig(1).calculate(wanted, found)
    assert found.duration <= time_optimal(path, LIMITS, share=1.0).duration <= found.duration + 0.03


def test_no_limit_is_exceeded():
    rng = np.random.default_rng(0)
    limits = LIMITS + JointLimits(*(np.array([value]) for value in (-1.0, 1.0, 2.0, 20.0, 400.0, 1.0)))
    trajectory = time_optimal(rng.uniform(limits.lower, limits.upper, (4, 8)), limits)
    assert not limits_used(trajectory, limits).exceeded
