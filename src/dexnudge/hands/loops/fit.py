"""Closed loops of an MJCF hand as coupled joints: what `<connect>`, `<weld>` and other equalities leave free.

A loop is solved with MuJoCo's own residuals over the range of the joints that drive it. Each other joint then follows one
of these as multiplier * angle + offset, with the least largest error. Where that is too far off, the hand is refused.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import linprog

from dexnudge.errors import HandError
from dexnudge.hands.loops.closing import Closing, Equalities, Loop

MAX_OFFSET = 0.001  # [m] at a loop's points, when its joints follow one another as straight lines
MAX_ANGLE = np.radians(3.0)  # [rad] of a joint off its line
LEAST_RANGE = 0.1  # of a driving joint's range that a loop must leave
DIGITS = 6  # of a follower's multiplier and offset: the loop is not known better


@dataclass(frozen=True)
class Follower:
    """angle = multiplier * angle(leader) + offset, at most `error` [rad or m] off."""

    leader: int
    multiplier: float
    offset: float
    error: float


@dataclass(frozen=True)
class SolvedLoop:
    """How a loop moves: its followers, the range that it leaves to its leaders, and the distance of its points [m]."""

    loop: Loop
    followers: dict[int, Follower]
    ranges: dict[int, tuple[float, float]]
    offset: float


def solve_loop(equalities: Equalities, loop: Loop, driven: list[int]) -> SolvedLoop:
    """Return a loop's joints as leaders and followers.

    Args:
        equalities: the model's residuals.
        loop: what is tied together.
        driven: those of its joints that motors drive, the nearest to the palm first.

    Raises:
        HandError: the loop cannot be closed, cannot move, or moves too unlike straight lines.
    """
    closing = Closing(equalities, loop)
    starts = closing.starts()
    leaders = closing.leaders(starts, driven)
    grid, closed, values = closing.over_range(starts, leaders)
    low, high = _closed_range(grid, closed, starts[0][[loop.joints.index(joint) for joint in leaders]])
    inside = closed & ((grid >= low - 1e-9) & (grid <= high + 1e-9)).all(axis=1)
    narrow = (high - low) < LEAST_RANGE * np.ptp(grid, axis=0)
    if narrow.any():
        raise HandError(
            f"{loop.name} leaves joint '{closing.names[leaders[int(np.argmax(narrow))]]}' no range to move in: expected a "
            "loop that closes over its limits; mend the limits or the loop"
        )
    followers: dict[int, Follower] = {}
    for column, joint in enumerate(loop.joints):
        if joint not in leaders:
            fits = [straight_line(grid[inside, k], values[inside, column], leaders[k]) for k in range(len(leaders))]
            followers[joint] = min(fits, key=lambda fit: fit.error)
    solved = values[inside].copy()
    for joint, fit in followers.items():
        solved[:, loop.joints.index(joint)] = fit.multiplier * grid[inside, leaders.index(fit.leader)] + fit.offset
    offset = max(closing.offset(row) for row in solved)
    ranges = {joint: (float(low[k]), float(high[k])) for k, joint in enumerate(leaders)}
    found = SolvedLoop(loop, followers, ranges, offset)
    worst = max(followers, key=lambda joint: followers[joint].error / most_error(equalities.model, joint))
    if offset > MAX_OFFSET or followers[worst].error > most_error(equalities.model, worst):
        raise HandError(
            f"{loop.name}: no straight line through the loop: expected joints that follow one another within "
            f"{MAX_OFFSET * 1e3:g} mm and {np.degrees(MAX_ANGLE):g} deg, got {offset * 1e3:.1f} mm at the loop, "
            f"{size_text(equalities.model, worst, followers[worst].error)} for joint '{closing.names[worst]}'; "
            "narrow the range of the joint that drives it, or replace the loop by <joint> equalities"
        )
    return found


def most_error(model: mujoco.MjModel, joint: int) -> float:
    """Return how far a follower may be off its straight line [rad or m]."""
    return MAX_OFFSET if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else float(MAX_ANGLE)


def size_text(model: mujoco.MjModel, joint: int, value: float) -> str:
    """Return a joint's value [rad or m] in degrees or millimetres."""
    slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    return f"{value * 1e3:.3g} mm" if slides else f"{np.degrees(value):.3g} deg"


def _closed_range(grid: np.ndarray, closed: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and greatest values of the leaders about `centre` between which the loop closes."""
    low, high = grid.min(axis=0), grid.max(axis=0)
    size = np.maximum(high - low, 1e-12)
    for row in sorted(np.flatnonzero(~closed), key=lambda row: float(np.abs((grid[row] - centre) / size).max())):
        inside = (grid[row] >= low) & (grid[row] <= high)
        if inside.all():
            axis = int(np.argmax(np.abs((grid[row] - centre) / size)))
            nearer = np.unique(grid[:, axis])
            if grid[row, axis] < centre[axis]:
                low[axis] = nearer[nearer > grid[row, axis]].min()
            else:
                high[axis] = nearer[nearer < grid[row, axis]].max()
    return low, high


def straight_line(x: np.ndarray, y: np.ndarray, leader: int) -> Follower:
    """Return the straight line with the least largest error from y (Chebyshev's)."""
    middle, size = x.mean(), max(float(np.ptp(x)), 1e-12)
    columns = np.column_stack([(x - middle) / size, np.ones_like(x)])
    band = np.ones((len(x), 1))
    best = linprog(
        [0.0, 0.0, 1.0],
        A_ub=np.block([[columns, -band], [-columns, -band]]),
        b_ub=np.concatenate([y, -y]),
        bounds=[(None, None), (None, None), (0.0, None)],
    )
    slope, height, error = best.x
    multiplier = round(float(slope / size), DIGITS)
    return Follower(leader, multiplier, round(float(height - multiplier * middle), DIGITS), float(error))
