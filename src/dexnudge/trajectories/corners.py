"""A polyline in joint space whose corners are rounded, and how fast its parts can be passed."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PPoly

from dexnudge.arms.arm import JointLimits
from dexnudge.trajectories.speed import Stretch

LARGEST_CORNER = 0.4  # of the shorter of its two lines; what is left serves for changing speed
APEX = 3 / 32  # a corner of length 1 leaves the polyline by this, times the change of direction


def rounded_polyline(
    path: Float[np.ndarray, "waypoint n"], limits: JointLimits, corner: float
) -> tuple[PPoly, list[Stretch]]:
    """Return q(s), and its stretches; s grows by 1 a second where the joints move as fast as they may.

    Over a corner of length L in s the tangent turns from u to w as u + (w - u)(3 x^2 - 2 x^3), x from 0 to 1.
    It is passed at constant speed. corner: the greatest distance of any joint from the polyline [rad].
    """
    steps = np.diff(path, axis=0)
    lengths = (np.abs(steps) / limits.velocity).max(axis=1)
    tangents = steps / lengths[:, None]
    turns = np.diff(tangents, axis=0)
    halves = np.zeros(len(path))
    sharp = np.abs(turns).max(axis=1, initial=0.0)
    if corner > 0:
        allowed = corner / (2 * APEX * np.maximum(sharp, 1e-9))
        halves[1:-1] = np.minimum(allowed, LARGEST_CORNER * np.minimum(lengths[:-1], lengths[1:]))
    breaks, coefficients, stretches = [0.0], [], []
    for number, (start, tangent, length) in enumerate(zip(path[:-1], tangents, lengths, strict=True)):
        first = start + tangent * halves[number]
        straight = length - halves[number] - halves[number + 1]
        coefficients.append(_polynomial(first, tangent))
        breaks.append(breaks[-1] + straight)
        size = np.maximum(np.abs(tangent), 1e-12)
        stretches.append(
            Stretch(straight, 1.0, float((limits.acceleration / size).min()), float((limits.jerk / size).min()))
        )
        if number + 1 == len(lengths):
            break
        turn, span = turns[number], 2 * halves[number + 1]
        if span == 0:
            stretches[-1] = stretches[-1]
            stretches.append(Stretch(0.0, 0.0, 0.0, 0.0))
            continue
        coefficients.append(_polynomial(first + tangent * straight, tangent, turn / span**2, -turn / (2 * span**3)))
        breaks.append(breaks[-1] + span)
        stretches.append(Stretch(span, _corner_speed(turn, span, limits), 0.0, 0.0))
    return PPoly(np.array(coefficients).transpose(1, 0, 2), np.array(breaks)), stretches


def _polynomial(
    place: np.ndarray, tangent: np.ndarray, cubic: np.ndarray | None = None, quartic: np.ndarray | None = None
) -> np.ndarray:
    none = np.zeros_like(place)
    return np.stack([none if quartic is None else quartic, none if cubic is None else cubic, none, tangent, place])


def _corner_speed(turn: Float[np.ndarray, " n"], span: float, limits: JointLimits) -> float:
    """Return the greatest constant speed: accelerations up to 1.5 |w - u| v^2 / L, jerks up to 6 |w - u| v^3 / L^2."""
    size = np.maximum(np.abs(turn), 1e-12)
    by_acceleration = np.sqrt(limits.acceleration * span / (1.5 * size)).min()
    by_jerk = np.cbrt(limits.jerk * span**2 / (6 * size)).min()
    return float(min(1.0, by_acceleration, by_jerk))
