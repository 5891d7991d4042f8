"""Where a hand that has let go moves, straight, so that it can open its fingers and plan its next way."""

from itertools import combinations

import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.planning.hand_states import palm_pose, state, state_space
from dexnudge.planning.motion_check import MotionCheck
from dexnudge.scenes.scene import Scene

DISTANCES = (0.0, 0.03, 0.06, 0.10, 0.15, 0.20, 0.30)  # [m] the least that will do is taken
STEP = 0.002  # [m] between the places that are looked at
MOST_START_CLEARANCE = 0.0015  # [m] asked for while it moves away, or what it has where it stands


def retreat(hand: Hand, scene: Scene, q: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, " 3"] | None:
    """The shortest translation [m, world] after which the fingers can open without touching anything; None: all blocked.

    Tried are up, back along the fingers, back of the hand first, along the scene's motion and against it, and the sums of
    two of them.
    """
    space = state_space(hand, q[ROOT_COORDINATES:])
    measure = HandClearance(hand, scene)
    pose = palm_pose(q)
    here = state(pose, 0.0)
    room = MotionCheck(space, measure)
    now = float(room.clearances(here[None]).distance.min())
    moving = MotionCheck(space, measure, max(0.0, min(MOST_START_CLEARANCE, now)))
    back = -pose[:3, :3]
    own = [
        np.array([0.0, 0.0, 1.0]),
        back @ hand.finger_axis,
        back @ hand.palm_normal,
        scene.motion,
        -scene.motion,
    ]
    sums = own + [one + two for one, two in combinations(own, 2)]
    directions = [total / np.linalg.norm(total) for total in sums if np.linalg.norm(total) > 0.3]
    for distance in DISTANCES:
        for direction in directions[: 1 if distance == 0 else None]:
            there, opened = here.copy(), here.copy()
            there[:3] += distance * direction
            opened[:3], opened[7] = there[:3], 1.0
            if room.free(there, opened) and _moves(moving, here, there):
                return distance * direction
    return None


def _moves(check: MotionCheck, here: np.ndarray, there: np.ndarray) -> bool:
    """Whether the straight motion keeps the clearance of `check`, looked at every few millimetres."""
    count = int(np.ceil(np.linalg.norm(there[:3] - here[:3]) / STEP)) + 1
    states = np.linspace(here, there, count)
    return bool((check.clearances(states, stop=check.clearance).distance >= check.clearance).all())
