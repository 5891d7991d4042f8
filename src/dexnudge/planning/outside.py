"""States of a hand outside the surroundings, from where a way to the object can begin."""

import numpy as np
from jaxtyping import Float

from dexnudge.planning.hand_states import States
from dexnudge.planning.motion_check import MotionCheck
from dexnudge.scenes.scene import Scene

GAP = 0.05  # [m] between the hand and the bounding box of surroundings and object
FARTHEST = 0.6  # [m] in a room, which no hand leaves, the way begins this far from where it ends
START_CLEARANCE = 0.02  # [m] of the whole hand
BELOW = -0.5  # z of a direction below which it is tried last: arms come from above or from a side

AXES = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], dtype=float)


def outside_states(
    scene: Scene,
    check: MotionCheck,
    waiting: States,
    *,
    directions: Float[np.ndarray, "direction 3"],
) -> tuple[States, States]:
    """Free states outside, with open fingers, and the state of `waiting` that each was moved out from, nearest first.

    Each is a state of `waiting` moved along an axis of the world or one of `directions` (unit) until a ball about the
    hand is clear of the box around surroundings and object, at most `FARTHEST`.
    """
    both = np.stack([scene.environment_mesh.bounds, scene.object_in_world().bounds])
    low, high = both[:, 0].min(axis=0) - GAP, both[:, 1].max(axis=0) + GAP
    starts, origins, cost = [], [], []
    for origin in waiting:
        for direction in np.concatenate([AXES, directions]):
            way = _way_out(origin[:3], direction, low - check.space.reach, high + check.space.reach)
            start = origin.copy()
            start[:3] += min(way, FARTHEST) * direction
            start[7] = 1.0
            starts.append(start)
            origins.append(origin)
            cost.append(min(way, FARTHEST) + (direction[2] < BELOW))
    order = np.argsort(cost, kind="stable")
    chosen, ends = np.array(starts)[order], np.array(origins)[order]
    free = check.clearances(chosen, stop=START_CLEARANCE).distance.min(axis=1) >= START_CLEARANCE
    return chosen[free], ends[free]


def _way_out(
    point: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"], low: np.ndarray, high: np.ndarray
) -> float:
    """Distance along `direction` to where it leaves the box [m]; 0 from outside."""
    if (point < low).any() or (point > high).any():
        return 0.0
    moving = np.abs(direction) > 1e-9
    face = np.where(direction > 0, high, low)
    return float(((face - point)[moving] / direction[moving]).min())
