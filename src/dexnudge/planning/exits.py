"""How a hand that waits before contact comes out into the open."""

from itertools import combinations

import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.planning.approach import Waiting
from dexnudge.planning.connect import connect
from dexnudge.planning.hand_motion import States, matrices
from dexnudge.scenes.scene import Scene

OPEN = 0.03  # [m] of clearance with which a hand counts as being in the open
FARTHEST = 0.50  # [m] from where it waits
STEP = 0.02  # [m] between the places that are looked at
BELOW = -0.3  # z of a direction below which it is not tried: arms come from above or from a side
MOST_WAITING = 4  # places that are looked at, the preferred ones first
MOST_ENDS = 6  # in the open, of straight ways that are blocked, to which a way around is sought
BUDGET = 6_000  # states of the hand that RRT-Connect may look at


def exits(hand: Hand, scene: Scene, waiting: Waiting, *, seed: int) -> list[States]:
    """Return free ways from the open to where the hand waits, straight ones, the shortest first; else one around obstacles.

    Straight ways lead along the motion, up, back along the fingers, back of the hand first, and along sums of two of these.
    Empty where none is found.
    """
    distances = np.arange(STEP, FARTHEST + STEP / 2, STEP)
    free: list[tuple[float, States]] = []
    blocked: list[tuple[float, States]] = []
    nearest = waiting.states[:MOST_WAITING]
    for state, rotation in zip(nearest, matrices(nearest), strict=True):
        for direction in _directions(hand, rotation, scene.motion):
            states = np.repeat(state[None], len(distances), axis=0)
            states[:, :3] += distances[:, None] * direction
            room = waiting.check.clearances(states, stop=waiting.check.clearance).distance.min(axis=1)
            roomy = np.flatnonzero(room >= OPEN)
            if len(roomy):
                end = int(roomy[0])
                passes = (room[:end] >= waiting.check.clearance).all() and waiting.check.free(states[end], state)
                (free if passes else blocked).append((distances[end], np.stack([states[end], state])))
    if free or not blocked:
        return [way for _, way in sorted(free, key=lambda pair: pair[0])]
    ends = np.array([way[0] for _, way in sorted(blocked, key=lambda pair: pair[0])[:MOST_ENDS]])
    around = connect(waiting.check, ends, waiting.states, seed=seed, budget=BUDGET)
    return [] if around is None else [around]


def _directions(
    hand: Hand, rotation: Float[np.ndarray, "3 3"], motion: Float[np.ndarray, " 3"]
) -> list[Float[np.ndarray, " 3"]]:
    own = [motion, np.array([0.0, 0.0, 1.0]), -rotation @ hand.finger_axis, -rotation @ hand.palm_normal]
    sums = own + [one + two for one, two in combinations(own, 2)]
    units = [total / np.linalg.norm(total) for total in sums if np.linalg.norm(total) > 0.3]
    return [unit for unit in units if unit[2] > BELOW]
