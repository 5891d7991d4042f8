"""From ways in joint space to trajectories within velocity, acceleration and jerk limits, sampled on one grid.

A way q(s) is passed with a speed ds/dt that ruckig plans stretch by stretch; q(s(t)) is then smoothed by a moving
average over one interval of the grid, which keeps every limit, since it averages admissible trajectories.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, PPoly

from dexnudge.arms.arm import JointLimits
from dexnudge.trajectories.corners import rounded_polyline
from dexnudge.trajectories.limits import limits_used
from dexnudge.trajectories.plan import JointTrajectory
from dexnudge.trajectories.speed import speed_profile
from dexnudge.trajectories.ways import smooth_way, way_stretches

SAMPLE_INTERVAL = 0.01  # [s] between the samples of every trajectory, which all lie on multiples of it
SHARE = 0.95  # of velocity, acceleration and jerk limits that plans use: what is left is the controller's
CORNER = 0.03  # [rad] how far a joint may leave the polyline where it turns
RAMP = 0.2  # [s] an object is brought to the 0.05 m/s of a push with a fortieth of gravity's acceleration
WINDOW = 10  # parts of SAMPLE_INTERVAL over which the moving average goes
DISTINCT = 1e-9  # [rad] waypoints nearer than this are one


def time_optimal(
    path: Float[np.ndarray, "waypoint n"], limits: JointLimits, *, corner: float = CORNER, share: float = SHARE
) -> JointTrajectory:
    """Return the fastest passage of a polyline in joint space, from rest to rest, efforts zero.

    Corners are rounded: no joint leaves the polyline by more than `corner` [rad] (plus 0.1 mrad). With 0 the joints
    stop at each waypoint and stay on the straight lines. share: of the limits that may be used.
    """
    path = np.asarray(path, dtype=float)
    keep = np.r_[True, np.abs(np.diff(path, axis=0)).max(axis=1, initial=0.0) > DISTINCT]
    path = path[keep]
    if len(path) == 1:
        return hold(path[0], SAMPLE_INTERVAL)
    used = shared(limits, share)
    way, stretches = rounded_polyline(path, used, corner)
    return _sampled(way, speed_profile(stretches), used, path[-1])


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

    progress: increasing, [m] or another unit. speed: of progress [unit/s]; None: as fast as the limits allow, which
    it is too where they do not allow `speed`. ramp: in which `speed` is reached at the earliest [s]. The way is
    smoothed: positions may carry 0.01 mrad of noise.
    """
    path = np.asarray(path, dtype=float)
    if len(path) == 1 or np.abs(path - path[0]).max() <= DISTINCT:
        seconds = 0.0 if speed is None or len(path) == 1 else (progress[-1] - progress[0]) / speed
        return hold(path[0], max(seconds, SAMPLE_INTERVAL))
    used = shared(limits, share)
    way = smooth_way(path, np.asarray(progress, dtype=float) - progress[0])
    return _sampled(way, speed_profile(way_stretches(way, used, speed, ramp)), used, path[-1])


def hold(position: Float[np.ndarray, " n"], seconds: float) -> JointTrajectory:
    """Return a stay at a position, at least one interval long, rounded up to whole ones."""
    samples = max(_intervals(seconds), 1) + 1
    still = np.zeros((samples, len(position)))
    return JointTrajectory(np.arange(samples) * SAMPLE_INTERVAL, still + position, still, still.copy(), still.copy())


def concatenated(*trajectories: JointTrajectory) -> JointTrajectory:
    """Return trajectories one after another; a sample at a joint stands once, with the effort of what follows.

    Raises:
        ValueError: one does not start where and as the one before ends.
    """
    first, *others = trajectories
    parts = {name: [getattr(first, name)] for name in ("time", "position", "velocity", "acceleration", "effort")}
    end = first
    for number, other in enumerate(others, start=2):
        for name in ("position", "velocity", "acceleration"):
            gap = np.abs(getattr(other, name)[0] - getattr(end, name)[-1]).max()
            if gap > 1e-6:
                raise ValueError(
                    f"trajectory {number} does not start where the one before ends: {name} jumps by {gap:.3g}"
                )
        start = parts["time"][-1][-1] - other.time[0]
        parts = {name: [*values[:-1], values[-1][:-1], getattr(other, name)] for name, values in parts.items()}
        parts["time"][-1] = other.time + start
        end = other
    joined = JointTrajectory(**{name: np.concatenate(values) for name, values in parts.items()})
    steps = np.rint(joined.time / SAMPLE_INTERVAL)
    on_grid = np.abs(joined.time - steps * SAMPLE_INTERVAL).max() < 1e-9
    return replace(joined, time=steps * SAMPLE_INTERVAL) if on_grid else joined


def shared(limits: JointLimits, share: float) -> JointLimits:
    """Return limits of which velocity, acceleration and jerk are a share."""
    return replace(
        limits, velocity=limits.velocity * share, acceleration=limits.acceleration * share, jerk=limits.jerk * share
    )


def _intervals(seconds: float) -> int:
    return int(np.ceil(seconds / SAMPLE_INTERVAL - 1e-9))


def _sampled(
    way: PPoly | BSpline, profile: PPoly, limits: JointLimits, goal: Float[np.ndarray, " n"]
) -> JointTrajectory:
    """Return the samples of way(profile(t)), slowed down where the quintics between them exceed limits."""
    fastest = profile.x[-1]
    intervals = _intervals(fastest) + 1
    while True:
        trajectory = _averaged(way, profile, intervals, goal)
        stretch = limits_used(trajectory, limits).stretch
        if stretch <= 1 + 1e-9:
            return trajectory
        intervals = max(_intervals(trajectory.duration * stretch), intervals + 1)


def _averaged(way: PPoly | BSpline, profile: PPoly, intervals: int, goal: Float[np.ndarray, " n"]) -> JointTrajectory:
    """Return samples of the moving average over one interval, in `intervals` intervals."""
    duration = (intervals - 1) * SAMPLE_INTERVAL
    slower = duration / profile.x[-1]
    fine = (np.arange(-WINDOW, intervals * WINDOW + 1) * (SAMPLE_INTERVAL / WINDOW)).clip(0.0, duration) / slower
    s, speed, change = (profile(fine, order) for order in range(3))
    s = s.clip(0.0, profile(profile.x[-1]))
    tangent = way(s, 1)
    values = np.stack(
        [
            way(s),
            tangent * speed[:, None] / slower,
            (way(s, 2) * speed[:, None] ** 2 + tangent * change[:, None]) / slower**2,
        ]
    )
    windows = np.lib.stride_tricks.sliding_window_view(values, WINDOW + 1, axis=1)[:, ::WINDOW]
    position, velocity, acceleration = windows.mean(axis=-1)
    position[-1] = goal
    velocity[[0, -1]] = acceleration[[0, -1]] = 0.0
    time = np.arange(intervals + 1) * SAMPLE_INTERVAL
    return JointTrajectory(time, position, velocity, acceleration, np.zeros_like(position))
