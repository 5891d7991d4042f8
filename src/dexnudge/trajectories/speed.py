"""How fast a way q(s) is passed: s(t), from rest to rest."""

import numpy as np
from jaxtyping import Float
from ruckig import InputParameter, Result, Ruckig, Trajectory
from scipy.interpolate import BSpline, PPoly

from dexnudge.arms.arm import JointLimits

GRID = 100  # places at least along a way at which limits are kept exactly
GRID_OF_PIECE = 12  # and at least along each polynomial: with 6, accelerations exceed limits by 5 % between them
STILL = 1e-12  # [rad/s] of a joint that does not move, in place of zero


def straight_profile(tangent: Float[np.ndarray, " n"], length: float, limits: JointLimits) -> PPoly:
    """Return the fastest s(t) along q = tangent s, to s = length, with all limits, the jerk's too."""
    size = np.maximum(np.abs(tangent), STILL)
    wanted, found = InputParameter(1), Trajectory(1)
    wanted.target_position = [length]
    wanted.max_velocity = [float((limits.velocity / size).min())]
    wanted.max_acceleration = [float((limits.acceleration / size).min())]
    wanted.max_jerk = [float((limits.jerk / size).min())]
    result = Ruckig(1).calculate(wanted, found)
    if result != Result.Working:
        raise ArithmeticError(f"ruckig finds no profile for {length} along {tangent}: {result}")
    profile = found.profiles[0][0]
    duration = np.array(profile.t)
    rows = np.array([np.array(profile.j) / 6, np.array(profile.a[:7]) / 2, profile.v[:7], profile.p[:7]])
    kept = duration > 0
    return PPoly(rows[:, kept], np.r_[0.0, np.cumsum(duration[kept])])


def fastest_profile(way: PPoly | BSpline, breaks: Float[np.ndarray, " knot"], limits: JointLimits) -> PPoly | None:
    """Return the fastest s(t) along a way within velocity and acceleration limits, by TOPP-RA; None if that fails.

    breaks: of s, between which the way is a polynomial; s(t) is quadratic between places that hold them.
    """
    from toppra import constraint  # here: it brings matplotlib
    from toppra.algorithm import TOPPRA
    from toppra.interpolator import AbstractGeometricPath

    class Path(AbstractGeometricPath):
        dof = len(limits.velocity)
        path_interval = breaks[[0, -1]]
        waypoints = None

        def __call__(self, path_positions: np.ndarray, order: int = 0) -> np.ndarray:
            return np.asarray(way(path_positions, order))

    lengths = np.diff(breaks)
    parts = np.maximum(GRID_OF_PIECE, np.ceil(lengths * (GRID / lengths.sum()))).astype(int)
    starts = zip(breaks[:-1], lengths, parts, strict=True)
    pieces = [start + length * np.arange(part) / part for start, length, part in starts]
    grid = np.r_[np.concatenate(pieces), breaks[-1]]
    bounds = [np.stack([-values, values], axis=1) for values in (limits.velocity, limits.acceleration)]
    constraints = [constraint.JointVelocityConstraint(bounds[0]), constraint.JointAccelerationConstraint(bounds[1])]
    speed = TOPPRA(constraints, Path(), gridpoints=grid).compute_parameterization(0.0, 0.0)[1]
    if speed is None or not np.isfinite(speed).all() or (speed[1:-1] <= 0).any():
        return None
    duration = 2 * np.diff(grid) / (speed[1:] + speed[:-1])
    rows = np.array([np.diff(speed) / duration / 2, speed[:-1], grid[:-1]])
    return PPoly(rows, np.r_[0.0, np.cumsum(duration)])
