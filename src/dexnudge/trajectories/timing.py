"""From ways in joint space to trajectories within velocity, acceleration and jerk limits, sampled on one grid.

A straight motion is timed by ruckig, with its limits of jerk. Another way q(s) is passed as fast as velocities and
accelerations allow (TOPP-RA); a moving average over q(s(t)) then bounds the jerk, for the time of its window, once.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, PPoly, make_interp_spline, make_lsq_spline

from dexnudge.arms.arm import JointLimits
from dexnudge.errors import InputError
from dexnudge.trajectories.interpolation import TOLERANCE, limits_used
from dexnudge.trajectories.plan import JointTrajectory
from dexnudge.trajectories.speed import Motion, fastest_profile, straight_profile

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


SAMPLE_INTERVAL = 0.01  # [s] between the samples of every trajectory, which all lie on multiples of it
SHARE = 0.95  # of velocity, acceleration and jerk limits that plans use: what is left is the controller's
CORNER = 0.03  # [rad] how far a joint may leave the polyline where it turns
WAY_DEVIATION = 0.001  # [rad] how far the moving average may take a joint from a way
RAMP = 0.2  # [s] an object is brought to the 0.05 m/s of a push with a twentieth of gravity's acceleration
UNLIMITED = (1e2, 1e4, 1e6)  # [rad/s], [rad/s^2], [rad/s^3] in place of more: the first is reached in one interval
TRIES = 50  # three are usual
HEADROOM = 1e-4  # by which more is slowed down than seems needed, twice that with each try, so that few are enough
DISTINCT = 1e-9  # [rad] waypoints nearer than this are one
LARGEST_JUMP = 1e-6  # [rad], [rad/s], [rad/s^2] between trajectories that are joined: rounding
UNHURRIED = 100.0  # times the mean speed that the joints allow: it bounds nothing


def time_optimal(
    path: Float[np.ndarray, "waypoint n"], limits: JointLimits, *, corner: float = CORNER, share: float = SHARE
) -> JointTrajectory:
    """Return the fastest passage of a polyline in joint space, from rest to rest, efforts zero.

    Corners are rounded: no joint leaves the polyline by more than about `corner` [rad]. With 0 the joints stop at each
    waypoint and stay on the straight lines. share: of the limits that may be used.

    Raises:
        InputError: `path` is empty or not finite.
    """
    path = _checked(path)
    path = path[np.r_[True, np.abs(np.diff(path, axis=0)).max(axis=1, initial=0.0) > DISTINCT]]
    used = _shared(limits, share)
    if len(path) == 1:
        return hold(path[0], SAMPLE_INTERVAL)
    if len(path) > 2 and corner > 0:
        way = rounded_polyline(path, used.velocity, corner / 2)
        near = _near(used, corner / 2)
        motion = Motion(way, fastest_profile(way, way.x, near))
        return _sampled(motion, used, path[-1], _longest_window(near))
    return concatenated(*(_straight(start, goal, used) for start, goal in pairwise(path)))


def timed_way(
    path: Float[np.ndarray, "station n"],
    progress: Float[np.ndarray, " station"],
    limits: JointLimits,
    *,
    speed: float | None = None,
    ramp: float = RAMP,
    share: float = SHARE,
) -> JointTrajectory:
    """Return a passage at constant speed of a way given by dense stations, from rest to rest, efforts zero.

    progress: increasing, [m] or another unit. speed: of progress [unit/s]; less where the limits demand it; None: as
    fast as they allow. ramp: in which `speed` is reached and left [s]. The way is smoothed: positions may carry
    0.01 mrad of noise.

    Raises:
        InputError: `path` is empty or not finite.
    """
    path, progress = _checked(path), np.asarray(progress, dtype=float) - progress[0]
    used = _shared(limits, share)
    fastest = (np.abs(np.diff(path, axis=0)) / used.velocity).max(axis=1, initial=0.0).sum()
    if len(path) == 1 or (speed is None and fastest == 0):
        return hold(path[0], SAMPLE_INTERVAL)
    s = progress / speed if speed is not None else progress * (fastest / progress[-1])
    stations = np.column_stack([path, s])
    of_progress = _of_progress(speed, ramp)
    used, near = used + of_progress, _near(used, WAY_DEVIATION) + of_progress
    lower = np.minimum(used.lower, stations.min(axis=0))
    upper = np.maximum(used.upper, stations.max(axis=0))
    way = smooth_way(stations, s, np.r_[lower[:-1], 0.0], np.r_[upper[:-1], s[-1]])
    motion = Motion(way, fastest_profile(way, np.unique(way.t), near))
    found = _sampled(motion, used, stations[-1], _longest_window(near))
    return JointTrajectory(
        found.time, *(values[:, :-1] for values in (found.position, found.velocity, found.acceleration, found.effort))
    )


def hold(position: Float[np.ndarray, " n"], seconds: float) -> JointTrajectory:
    """Return a stay at a position, at least one interval long, rounded up to whole ones."""
    samples = max(_intervals(seconds), 1) + 1
    still = np.zeros((samples, len(position)))
    return JointTrajectory(np.arange(samples) * SAMPLE_INTERVAL, still + position, still, still.copy(), still.copy())


def concatenated(*trajectories: JointTrajectory) -> JointTrajectory:
    """Return trajectories one after another; the sample at a joint stands once, as the one that follows has it.

    Raises:
        ValueError: one does not start where and as the one before ends.
    """
    for number, (one, other) in enumerate(pairwise(trajectories), start=2):
        for name in ("position", "velocity", "acceleration"):
            jump = np.abs(getattr(other, name)[0] - getattr(one, name)[-1]).max()
            if jump > LARGEST_JUMP:
                raise ValueError(
                    f"trajectory {number} does not start as the one before ends: {name} jumps by {jump:.3g}"
                )
    starts = np.cumsum([0.0, *(each.duration for each in trajectories[:-1])])
    times = [each.time - each.time[0] + start for each, start in zip(trajectories, starts, strict=True)]
    time = _joined(times)
    steps = np.rint(time / SAMPLE_INTERVAL)
    on_grid = np.abs(time / SAMPLE_INTERVAL - steps).max() < DISTINCT * len(time)
    values = ("position", "velocity", "acceleration", "effort")
    whole = {name: _joined([getattr(each, name) for each in trajectories]) for name in values}
    return JointTrajectory(steps * SAMPLE_INTERVAL if on_grid else time, **whole)


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([*(part[:-1] for part in parts[:-1]), parts[-1]])


def _checked(path: Float[np.ndarray, "waypoint n"]) -> Float[np.ndarray, "waypoint n"]:
    wrong = ~np.isfinite(path).all(axis=1)
    if wrong.any() or len(path) == 0:
        where = f"row {np.flatnonzero(wrong)[0]} of it is not finite" if len(path) else "it is empty"
        raise InputError(f"`path`: {where}; expected joint positions, a row for each of one or more waypoints")
    return np.asarray(path, dtype=float)


def _of_progress(speed: float | None, ramp: float) -> JointLimits:
    """Return limits of progress as of one more joint, in units of the speed: a ramp of two equal parts of jerk."""
    if speed is None:
        values = (UNHURRIED, UNHURRIED / SAMPLE_INTERVAL, UNHURRIED / SAMPLE_INTERVAL**2)
    else:
        values = (1.0, 2 / ramp, 4 / ramp**2)
    return JointLimits(*(np.array([value]) for value in (-np.inf, np.inf, *values, np.inf)))


def _shared(limits: JointLimits, share: float) -> JointLimits:
    """Return limits of which velocity, acceleration and jerk are a share; finite ones."""
    return replace(
        limits,
        velocity=np.minimum(limits.velocity, UNLIMITED[0]) * share,
        acceleration=np.minimum(limits.acceleration, UNLIMITED[1]) * share,
        jerk=np.minimum(limits.jerk, UNLIMITED[2]) * share,
    )


def _near(limits: JointLimits, deviation: float) -> JointLimits:
    """Return limits with accelerations at which the moving average moves no joint by more than a deviation [rad].

    A window w moves one whose acceleration is a by at most a w^2 / 24.
    """
    acceleration = np.minimum(limits.acceleration, np.cbrt(6 * deviation * limits.jerk**2))
    window = _longest_window(replace(limits, acceleration=acceleration)) + SAMPLE_INTERVAL
    return replace(limits, acceleration=np.minimum(acceleration, 24 * deviation / window**2))


def _longest_window(limits: JointLimits) -> float:
    """Return the window [s] in which any acceleration turns into its opposite with the jerk allowed, a few samples more."""
    return float((2 * limits.acceleration / limits.jerk).max()) + 2 * SAMPLE_INTERVAL


def _straight(start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"], limits: JointLimits) -> JointTrajectory:
    way = PPoly(np.stack([goal - start, start])[:, None], np.array([0.0, 1.0]))
    return _sampled(Motion(way, straight_profile(goal - start, limits)), limits, goal, SAMPLE_INTERVAL)


def _intervals(seconds: float) -> int:
    return int(np.ceil(seconds / SAMPLE_INTERVAL - DISTINCT))


def _sampled(
    motion: Motion, limits: JointLimits, goal: Float[np.ndarray, " n"], longest_window: float
) -> JointTrajectory:
    """Return samples whose quintics keep limits: averaged for as long as the jerk demands, slower where all else does.

    longest_window: of the average [s]; from there on it is slower for the jerk's sake, too.
    """
    slower, needed = 1.0, min(2 * SAMPLE_INTERVAL, longest_window)
    for attempt in range(TRIES):
        intervals = _intervals(motion.duration * slower + needed)
        window = intervals * SAMPLE_INTERVAL - motion.duration * slower
        time = np.arange(intervals + 1) * SAMPLE_INTERVAL
        position, velocity, acceleration = motion.averaged(time, window, slower)
        position[-1] = goal
        velocity[-1] = acceleration[-1] = 0.0
        trajectory = JointTrajectory(time, position, velocity, acceleration, np.zeros_like(position))
        used = limits_used(trajectory, limits)
        stretch, jerk = max(used.velocity.max(), used.acceleration.max() ** (1 / 2)), used.jerk.max()
        if max(stretch, jerk) <= 1 + TOLERANCE:
            return trajectory
        if jerk > 1 + TOLERANCE and window < longest_window:
            needed = min(window * jerk, longest_window)
        else:
            slower *= max(stretch, jerk ** (1 / 3)) * (1 + HEADROOM * 2**attempt)
    raise ArithmeticError(f"no motion within the limits is found; the last one uses {used}")
