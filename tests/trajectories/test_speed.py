"""The speed along a way is TOPP-RA's, as the package toppra has it."""

import numpy as np
import pytest
from toppra import algorithm, constraint
from toppra.interpolator import AbstractGeometricPath

from dexnudge.arms.arm import JointLimits
from dexnudge.arms.registry import LIMITS
from dexnudge.trajectories.speed import fastest_profile
from dexnudge.trajectories.timing import rounded_polyline

UR = JointLimits(*(np.full(6, value) for value in (-6.28, 6.28, 3.14, 5.0, 50.0, 1.0)))


class Path(AbstractGeometricPath):
    waypoints = dof = path_interval = None

    def __init__(self, way):
        self.way, self.dof, self.path_interval = way, way.c.shape[-1], way.x[[0, -1]]

    def __call__(self, path_positions, order=0):
        return self.way(path_positions, order)


@pytest.mark.parametrize("limits", [LIMITS, UR], ids=["panda", "ur"])
@pytest.mark.parametrize("waypoints", [3, 6])
@pytest.mark.parametrize("size", [0.02, 0.5])
def test_a_way_takes_the_time_that_toppra_finds(limits, waypoints, size):
    rng = np.random.default_rng(waypoints)
    path = np.cumsum(rng.normal(size=(waypoints, len(limits.velocity))), axis=0) * size
    path[1, 2] = path[0, 2]  # a joint that stands still for a while
    way = rounded_polyline(path, limits.velocity, 0.02)
    found = fastest_profile(way, way.x, limits)
    bounds = [np.stack([-bound, bound], axis=1) for bound in (limits.velocity, limits.acceleration)]
    constraints = [constraint.JointVelocityConstraint(bounds[0]), constraint.JointAccelerationConstraint(bounds[1])]
    grid = found(found.x).clip(0.0, way.x[-1])
    speed = algorithm.TOPPRA(constraints, Path(way), gridpoints=grid).compute_parameterization(0.0, 0.0)[1]
    assert found.x[-1] == pytest.approx((2 * np.diff(grid) / (speed[1:] + speed[:-1])).sum(), rel=1e-4)


def test_a_joint_that_turns_back_stops_there():
    way = rounded_polyline(np.array([[0.0], [1.0], [0.0]]), UR.velocity[:1], 0.001)
    one = JointLimits(**{name: values[:1] for name, values in vars(UR).items()})
    # Each way 1 rad: 3.14 rad/s are not reached at 5 rad/s^2, and so it takes 2 sqrt(1 / 5) s, once more on the way back.
    assert fastest_profile(way, way.x, one).x[-1] == pytest.approx(4 * np.sqrt(1 / 5), rel=0.02)
