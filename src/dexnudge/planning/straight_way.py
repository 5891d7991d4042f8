"""Arms that carry a hand along a given way: joint angles station by station, many ways at once."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.arms.inverse_kinematics import InverseKinematics
from dexnudge.planning.hand_motion import State, StateSpace, between

LARGEST_CHANGE = (
    0.20  # [rad] of a joint from one station to the next: more is a jump to another branch, or a singularity
)
STEPS = 8  # of inverse kinematics from one station to the next; two or three are usual


def follow(
    kinematics: InverseKinematics,
    T_world_flange: Float[np.ndarray, "way station 4 4"],
    start: Float[np.ndarray, "way n"],
) -> tuple[Float[np.ndarray, "way station n"], Bool[np.ndarray, "way station"]]:
    """Return the arm's joint angles at every station of ways that begin near `start`, and which stations were reached.

    After the first station that is out of reach, or reached by a jump alone, none of that way is reached.
    """
    angles, going = np.array(start, dtype=float), np.ones(len(start), dtype=bool)
    reached = np.zeros(T_world_flange.shape[:2], dtype=bool)
    found = np.zeros((*reached.shape, angles.shape[1]))
    for station in range(T_world_flange.shape[1]):
        rows = np.flatnonzero(going)
        if not len(rows):
            break
        solved = kinematics.solve_all(T_world_flange[rows, station], angles[rows], most_steps=STEPS)
        near = np.abs(solved.positions - angles[rows]).max(axis=1) <= LARGEST_CHANGE
        going[rows] = solved.solved & near
        angles[rows] = solved.positions
        found[:, station], reached[:, station] = angles, going
    return found, reached


def stations(
    space: StateSpace, path: Sequence[State] | Float[np.ndarray, "vertex 8"], *, spacing: float
) -> Float[np.ndarray, "station 8"]:
    """Return states along a path of the hand, from its first to its last vertex, all vertices among them.

    From one to the next no point of the hand moves farther than `spacing` [m].
    """
    rows = [np.asarray(path[0])[None]]
    for start, end in pairwise(path):
        count = max(1, int(np.ceil(space.displacement(start, end) / spacing)))
        rows.append(between(start, end, np.arange(1, count + 1) / count))
    return np.concatenate(rows)


def evenly(rows: Float[np.ndarray, "station 8"], count: int) -> Float[np.ndarray, "count 8"]:
    """Return `count` states on the same path, evenly spread over the stations, the first and the last among them."""
    places = np.linspace(0.0, len(rows) - 1, count)
    first = np.minimum(places.astype(int), len(rows) - 2)
    pairs = zip(first, places, strict=True)
    return np.array([between(rows[row], rows[row + 1], np.array([place - row]))[0] for row, place in pairs])
