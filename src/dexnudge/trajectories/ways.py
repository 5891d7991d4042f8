"""Ways in joint space as smooth curves: a polyline with rounded corners, or a spline near dense stations."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, PPoly, make_interp_spline, make_lsq_spline

LARGEST_CORNER = 0.5  # of the shorter of its two lines: corners do not overlap
APEX = 3 / 16  # a corner that begins and ends at a distance h in s leaves the polyline by this times h and the turn


def rounded_polyline(path: Float[np.ndarray, "waypoint n"], velocity: Float[np.ndarray, " n"], corner: float) -> PPoly:
    """Return q(s), twice differentiable; s grows by 1 a second where the joints move as fast as `velocity` lets them.

    Over a corner the tangent turns from u to w as u + (w - u)(3 x^2 - 2 x^3), x from 0 to 1.
    corner: the greatest distance of any joint from the polyline [rad].
    """
    steps = np.diff(path, axis=0)
    lengths = (np.abs(steps) / velocity).max(axis=1)
    tangents = steps / lengths[:, None]
    turns = np.diff(tangents, axis=0)
    sharpness = np.maximum(np.abs(turns).max(axis=1), np.finfo(float).eps)
    halves = np.minimum(corner / (APEX * sharpness), LARGEST_CORNER * np.minimum(lengths[:-1], lengths[1:]))
    halves = np.r_[0.0, halves, 0.0]
    none = np.zeros_like(path[0])
    durations, coefficients = [], []
    for number, (start, tangent, length) in enumerate(zip(path[:-1], tangents, lengths, strict=True)):
        before, after = halves[number], halves[number + 1]
        durations.append(length - before - after)
        coefficients.append([none, none, none, tangent, start + tangent * before])
        if number < len(turns):
            turn, span = turns[number], 2 * after
            durations.append(span)
            first = start + tangent * (length - after)
            coefficients.append([-turn / (2 * span**3), turn / span**2, none, tangent, first])
    kept = np.array(durations) > np.finfo(float).eps * sum(durations)
    breaks = np.r_[0.0, np.cumsum(np.array(durations)[kept])]
    return PPoly(np.array(coefficients)[kept].transpose(1, 0, 2), breaks)


DEGREE = 5
STATIONS_A_KNOT = 8  # the noise of the stations is averaged; of a curve that bends more the half, and so on
ROUGHEST = 5e-5  # [rad] greatest distance of the curve from a station
END_WEIGHT = 1e4  # ends are met to 1e-12 rad, since other pieces join there


def smooth_way(
    path: Float[np.ndarray, "station n"],
    s: Float[np.ndarray, " station"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
) -> BSpline:
    """Return q(s), near all stations, exact at both ends.

    It stays within 0.05 mrad of the stations, unless they are rough, and within lower and upper, which the stations
    keep, since its control points do.
    """
    weights = np.ones(len(path))
    weights[[0, -1]] = END_WEIGHT
    apart = STATIONS_A_KNOT
    while apart > 1:
        inner = s[apart : len(s) - apart : apart]
        knots = np.r_[[s[0]] * (DEGREE + 1), inner, [s[-1]] * (DEGREE + 1)]
        if len(path) > len(inner) + DEGREE + 1:
            curve = _bounded(make_lsq_spline(s, path, knots, k=DEGREE, w=weights), lower, upper)
            if np.abs(curve(s) - path).max() <= ROUGHEST:
                return curve
        apart //= 2
    return _bounded(make_interp_spline(s, path, k=min(3, len(path) - 1)), lower, upper)


def _bounded(curve: BSpline, lower: Float[np.ndarray, " n"], upper: Float[np.ndarray, " n"]) -> BSpline:
    return BSpline(curve.t, curve.c.clip(lower, upper), curve.k)
