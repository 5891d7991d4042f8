"""How fast a way is passed: stretches with limits of their own on speed, its change and its jerk, each by ruckig."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from ruckig import InputParameter, Result, Ruckig, Trajectory
from scipy.interpolate import PPoly


@dataclass(frozen=True)
class Stretch:
    """A part of a way, `length` long, and what ds/dt and its first and second derivatives may be on it.

    The acceleration is zero at its ends. With acceleration 0 it is passed at constant speed.
    """

    length: float
    speed: float
    acceleration: float
    jerk: float


def speed_profile(stretches: list[Stretch]) -> PPoly:
    """Return s(t) from rest to rest over all stretches: pieces of constant jerk, the fastest with these limits."""
    speeds = _boundary_speeds(stretches)
    start = [0.0]
    coefficients = []
    t, s = 0.0, 0.0
    for stretch, v0, v1 in zip(stretches, speeds[:-1], speeds[1:], strict=True):
        for duration, jerk, acceleration, speed, place in _pieces(stretch, v0, v1):
            if duration <= 0:
                continue
            coefficients.append([jerk / 6, acceleration / 2, speed, s + place])
            t += duration
            start.append(t)
        s += stretch.length
    return PPoly(np.array(coefficients).T, np.array(start))


def _pieces(stretch: Stretch, v0: float, v1: float) -> list[tuple[float, ...]]:
    """Return duration, jerk, and acceleration, speed and place at the start, of each piece of constant jerk."""
    if stretch.length == 0:
        return []
    if stretch.acceleration == 0:
        return [(stretch.length / v0, 0.0, 0.0, v0, 0.0)]
    wanted, found = InputParameter(1), Trajectory(1)
    wanted.current_velocity, wanted.target_velocity = [v0], [v1]
    wanted.target_position = [stretch.length]
    wanted.max_velocity = [max(stretch.speed, v0, v1)]
    wanted.max_acceleration, wanted.max_jerk = [stretch.acceleration], [stretch.jerk]
    result = Ruckig(1).calculate(wanted, found)
    if result != Result.Working:
        raise ArithmeticError(f"ruckig found no profile for {stretch} from {v0} to {v1}: {result}")
    profile = found.profiles[0][0]
    last = slice(len(profile.t))  # of these three also the end is given
    return list(zip(profile.t, profile.j, profile.a[last], profile.v[last], profile.p[last], strict=True))


def _boundary_speeds(stretches: list[Stretch]) -> list[float]:
    """Return the greatest speeds between stretches that can be reached from rest and come to rest."""
    speeds = [0.0, *(min(one.speed, other.speed) for one, other in pairwise(stretches)), 0.0]
    for number, stretch in enumerate(stretches):
        speeds[number + 1] = min(speeds[number + 1], _reachable(stretch, speeds[number]))
    for number, stretch in reversed(list(enumerate(stretches))):
        speeds[number] = min(speeds[number], _reachable(stretch, speeds[number + 1]))
    return speeds


def _reachable(stretch: Stretch, speed: float) -> float:
    """Return the greatest speed to which `speed` can change over a stretch, without acceleration at its ends."""
    if stretch.acceleration == 0:
        return speed
    low, high = speed, max(stretch.speed, speed)
    if _distance(stretch, speed, high) <= stretch.length:
        return high
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if _distance(stretch, speed, middle) <= stretch.length else (low, middle)
    return low


def _distance(stretch: Stretch, slow: float, fast: float) -> float:
    """Return how far one comes while the speed changes: S-shaped, and so at the mean of both."""
    change, ramp = fast - slow, stretch.acceleration / stretch.jerk
    duration = (
        change / stretch.acceleration + ramp
        if change >= stretch.acceleration * ramp
        else 2 * (change / stretch.jerk) ** 0.5
    )
    return duration * (slow + fast) / 2
