"""A moving average over a motion: it keeps velocity and acceleration limits and bounds the jerk.

The average of x over a window w long, ending at t, has the derivative (x(t) - x(t - w)) / w: so has the position the
velocity, the velocity the acceleration, and an acceleration within ±a the jerk, which is within 2 a / w.
"""

from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, PPoly

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)  # exact for degree 11: ways of degree 5, passed quadratically


class Motion:
    """The motion q(s(t)) from rest to rest, which rests before and after."""

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
