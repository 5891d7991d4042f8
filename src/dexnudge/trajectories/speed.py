"""How fast a way q(s) is passed: s(t), from rest to rest, and its moving average, which bounds the jerk."""

from functools import cached_property

import numpy as np
from jaxtyping import Float
from ruckig import InputParameter, Result, Ruckig, Trajectory
from scipy.interpolate import BSpline, PPoly

from dexnudge.arms.arm import JointLimits

GRID = 100  # places at least along a way at which limits are kept exactly
GRID_OF_PIECE = 12  # and at least along each polynomial: with 6, accelerations exceed limits by 5 % between them
LARGEST_GRID = 600  # places, unless two of a polynomial are more: of short ones, as between stations, few are enough
TINY = 1e-9  # [rad] by which q' is at least, in place of zero: a joint that does not move bounds nothing
SLOWEST = 1e-6  # of the greatest x: rounding never brings a motion to a halt
ROUNDING = 1e-9  # by which x is reduced beyond a crossing, so that it lies on the right side of it


def straight_profile(tangent: Float[np.ndarray, " n"], limits: JointLimits) -> PPoly:
    """Return the fastest s(t) along q = tangent s, from s = 0 to 1, with all limits, the jerk's too."""
    size = np.maximum(np.abs(tangent), TINY)
    wanted, found = InputParameter(1), Trajectory(1)
    wanted.target_position = [1.0]
    wanted.max_velocity = [float((limits.velocity / size).min())]
    wanted.max_acceleration = [float((limits.acceleration / size).min())]
    wanted.max_jerk = [float((limits.jerk / size).min())]
    result = Ruckig(1).calculate(wanted, found)
    if result != Result.Working:
        raise ArithmeticError(f"ruckig finds no profile along {tangent}: {result}")
    profile = found.profiles[0][0]
    duration = np.array(profile.t)
    rows = np.array([np.array(profile.j) / 6, np.array(profile.a[:7]) / 2, profile.v[:7], profile.p[:7]])
    kept = duration > 0
    return PPoly(rows[:, kept], np.r_[0.0, np.cumsum(duration[kept])])


def fastest_profile(way: PPoly | BSpline, breaks: Float[np.ndarray, " knot"], limits: JointLimits) -> PPoly:
    """Return the fastest s(t) along a way within velocity and acceleration limits.

    Over a grid of s, with x = (ds/dt)^2 and u = d2s/dt2, which is constant between two places:
    |q'| sqrt(x) <= v and |q' u + q'' x| <= a at both of them. Backwards, the greatest x from which the end can be
    reached; forwards, the greatest u. (TOPP-RA: Pham and Pham, IEEE Transactions on Robotics 34(3), 2018.)
    breaks: of s, between which the way is a polynomial; they are places of the grid, between which s(t) is quadratic.
    """
    lengths = np.diff(breaks)
    least = np.clip(LARGEST_GRID // len(lengths), 2, GRID_OF_PIECE)
    parts = np.maximum(least, np.ceil(lengths * (GRID / lengths.sum()))).astype(int)
    starts = zip(breaks[:-1], lengths, parts, strict=True)
    grid = np.r_[
        np.concatenate([start + length * np.arange(part) / part for start, length, part in starts]), breaks[-1]
    ]
    twice = 2 * np.diff(grid)  # a step takes x to x + twice u
    tangent, bend = way(grid, 1), way(grid, 2)
    # Each row of the grid bounds u by lines over x: low + slope x <= u <= high + slope x.
    by_u = np.hstack([tangent[:-1], tangent[1:] + twice[:, None] * bend[1:]])
    by_u = np.copysign(np.maximum(np.abs(by_u), TINY), by_u)
    reach = np.tile(limits.acceleration, 2) / np.abs(by_u)
    slope = np.column_stack([-np.hstack([bend[:-1], bend[1:]]) / by_u, -1 / twice])
    low, high = (np.column_stack([bound, np.zeros_like(twice)]) for bound in (-reach, reach))
    most = (limits.velocity / np.maximum(np.abs(tangent), TINY)).min(axis=1) ** 2
    most[-1] = 0.0
    for place in reversed(range(len(twice))):
        high[place, -1] = most[place + 1] / twice[place]
        most[place] = _greatest(most[place], low[place], high[place], slope[place])
    x = np.zeros(len(grid))
    for place, step in enumerate(twice):
        u = (high[place] + slope[place] * x[place]).min()
        x[place + 1] = np.clip(x[place] + step * u, SLOWEST * most[place + 1], most[place + 1])
    speed = np.sqrt(x)
    duration = twice / (speed[1:] + speed[:-1])
    rows = np.array([np.diff(speed) / duration / 2, speed[:-1], grid[:-1]])
    return PPoly(rows, np.r_[0.0, np.cumsum(duration)])


def _greatest(
    x: float, low: Float[np.ndarray, " line"], high: Float[np.ndarray, " line"], slope: Float[np.ndarray, " line"]
) -> float:
    """Return the greatest x, no greater than that given, at which no line of `low` is above one of `high` (Newton)."""
    while True:
        lines = slope * x
        one, other = np.argmax(low + lines), np.argmin(high + lines)
        if not low[one] + lines[one] > high[other] + lines[other]:
            return x
        x = min((high[other] - low[one]) / (slope[one] - slope[other]), x) * (1 - ROUNDING)


NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)  # exact for degree 11: ways of degree 5, passed quadratically


class Motion:
    """The motion q(s(t)) from rest to rest, which rests before and after.

    Its average over a window w long, ending at t, has the derivative (x(t) - x(t - w)) / w: so has the position the
    velocity, the velocity the acceleration, and an acceleration within ±a the jerk, which is within 2 a / w.
    """

    def __init__(self, way: PPoly | BSpline, profile: PPoly) -> None:
        self.way, self.profile = way, profile
        self.duration = float(profile.x[-1])  # [s]
        self._start, self._goal = way(profile(np.array([0.0, self.duration])))

    def averaged(
        self, time: Float[np.ndarray, " k"], window: float, slower: float
    ) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "k n"], Float[np.ndarray, "k n"]]:
        """Return position, velocity and acceleration at times [s] of the motion, `slower` times slower, averaged.

        It lasts slower * duration + window.
        """
        ends = np.stack([time - window, time]) / slower
        inside = ends.clip(0.0, self.duration)
        places, speeds = self.profile(inside), self.profile(inside, 1)
        position = self.way(places)
        velocity = self.way(places, 1) * speeds[..., None] / slower
        outside = (ends - inside)[..., None]
        integral = self._integral(inside) + np.where(outside > 0, self._goal - self._start, 0.0) * outside
        mean = self._start + (integral[1] - integral[0]) * (slower / window)
        return mean, (position[1] - position[0]) / window, (velocity[1] - velocity[0]) / window

    def _integral(self, time: Float[np.ndarray, "..."]) -> Float[np.ndarray, "... n"]:
        """Return the integral of position minus start."""
        knots = self.profile.x
        piece = np.searchsorted(knots[1:-1], time, side="right")
        return self._integrals[piece] + self._between(knots[piece], time)

    @cached_property
    def _integrals(self) -> Float[np.ndarray, "knot n"]:
        knots = self.profile.x
        pieces = self._between(knots[:-1], knots[1:])
        return np.concatenate([np.zeros_like(pieces[:1]), np.cumsum(pieces, axis=0)])

    def _between(self, first: Float[np.ndarray, "*t"], last: Float[np.ndarray, "*t"]) -> Float[np.ndarray, "*t n"]:
        half = (last - first)[..., None] / 2
        places = self.profile((first + last)[..., None] / 2 + half * NODES)
        return np.einsum("...gn,g->...n", self.way(places) - self._start, WEIGHTS) * half
