"""A way given by dense stations as one smooth curve."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, make_interp_spline, make_lsq_spline

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
