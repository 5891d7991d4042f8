"""A way given by dense stations as one smooth curve, and how fast it can be passed."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, make_interp_spline, make_lsq_spline

from dexnudge.arms.arm import JointLimits
from dexnudge.trajectories.speed import Stretch

DEGREE = 5  # continuous jerk
STATIONS_A_KNOT = 5  # noise of the stations is averaged
ROUGHEST = 5e-5  # [rad] greatest distance of the curve from a station
STATIONS_CHECKED = 5  # places looked at between two knots
END_WEIGHT = 1e4  # ends are met to 1e-12 rad, since other pieces join there


def smooth_way(path: Float[np.ndarray, "station n"], progress: Float[np.ndarray, " station"]) -> BSpline:
    """Return q(progress), continuous up to the jerk, within 0.05 mrad of all stations; exact at both ends."""
    weights = np.ones(len(path))
    weights[[0, -1]] = END_WEIGHT
    apart = STATIONS_A_KNOT
    while apart > 1:
        inner = progress[apart:-apart:apart]
        knots = np.r_[[progress[0]] * (DEGREE + 1), inner, [progress[-1]] * (DEGREE + 1)]
        if len(path) >= len(knots) - DEGREE - 1 + 2:
            curve = make_lsq_spline(progress, path, knots, k=DEGREE, w=weights)
            if np.abs(curve(progress) - path).max() <= ROUGHEST:
                return curve
        apart -= 1
    return make_interp_spline(progress, path, k=min(DEGREE, len(path) - 1))


def way_stretches(way: BSpline, limits: JointLimits, speed: float | None, ramp: float) -> list[Stretch]:
    """Return one stretch over the whole way with the speed, up to `speed`, that passes it fastest.

    ramp: in which `speed` is reached at the earliest [s]; the acceleration rises and falls once.
    """
    s = np.linspace(way.t[0], way.t[-1], STATIONS_CHECKED * len(way.t))
    first, second, third = (np.maximum(np.abs(way(s, order)).max(axis=0), 1e-9) for order in (1, 2, 3))
    length = float(way.t[-1] - way.t[0])
    most = float((limits.velocity / first).min())
    best, shortest = None, np.inf
    for candidate in np.geomspace(1.0, 0.01, 60) * (most if speed is None else min(most, speed)):
        acceleration = float(((limits.acceleration - second * candidate**2) / first).min())
        if acceleration <= 0:
            continue
        jerk = float(((limits.jerk - third * candidate**3 - 3 * second * candidate * acceleration) / first).min())
        if jerk <= 0:
            continue
        if speed is not None and ramp > 0:
            acceleration, jerk = min(acceleration, 2 * speed / ramp), min(jerk, 4 * speed / ramp**2)
        duration = length / candidate + candidate / acceleration + acceleration / jerk
        if duration < shortest:
            best, shortest = Stretch(length, candidate, acceleration, jerk), duration
    assert best is not None
    return [best]
