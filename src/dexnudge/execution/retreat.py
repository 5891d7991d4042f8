"""How a hand that has let go withdraws: straight away from what is around it, then its fingers open."""

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.planning.approach import OPENING_ALLOWANCE
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.planning.hand_motion import palm_pose, state_space
from dexnudge.planning.motion_check import CLEARANCE
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import PENETRATION_LIMIT
from dexnudge.verification.penetration import self_penetration

DISTANCES = (0.0, 0.03, 0.06, 0.10, 0.15, 0.20, 0.30)  # [m] the first that is free is taken
STEP = 0.002  # [m] between the places that are checked
OPENING_STEPS = 17  # openings that are checked between two sets of joint angles
LEAST_CLEARANCE = 0.0015  # [m] kept while it moves away, or what it has where it stands


@dataclass(frozen=True)
class Retreat:
    """way: translation of the hand [m, world]. openings: joint angles [rad] one after another, the last the open hand."""

    way: Float[np.ndarray, " 3"]
    openings: list[Float[np.ndarray, " joint"]]


def retreat(hand: Hand, scene: Scene, q: Float[np.ndarray, " coordinates"]) -> Retreat | None:
    """Return the shortest way after which the fingers can open without touching anything or each other; None if none.

    Tried are up, back along the fingers, back of the hand first, along the scene's motion and against it, and the sums of
    two of them.
    """
    openings = opening_path(hand, q[ROOT_COORDINATES:])
    if openings is None:
        return None
    pose = palm_pose(q)
    measure = HandClearance(hand, scene)

    def clear(shifts: np.ndarray, angles: np.ndarray, room: float) -> bool:
        rotation = np.repeat(pose[None, :3, :3], len(shifts), axis=0)
        return bool((measure(q[:3] + shifts, rotation, angles, stop=room).distance >= room).all())

    closed = q[None, ROOT_COORDINATES:]
    now = float(measure(q[None, :3], pose[None, :3, :3], closed).distance.min())
    room = max(0.0, min(LEAST_CLEARANCE, now))
    opening = _between([q[ROOT_COORDINATES:], *openings])
    for distance in DISTANCES:
        for direction in _directions(hand, pose, scene.motion)[: 1 if distance == 0 else None]:
            way = distance * direction
            shifts = np.linspace(0.0, 1.0, int(distance / STEP) + 2)[:, None] * way
            if clear(np.repeat(way[None], len(opening), axis=0), opening, CLEARANCE) and clear(
                shifts, np.repeat(closed, len(shifts), axis=0), room
            ):
                return Retreat(way, openings)
    return None


def opening_path(hand: Hand, angles: Float[np.ndarray, " joint"]) -> list[Float[np.ndarray, " joint"]] | None:
    """Return joint angles from these to the open hand; None if no clean order is found.

    The links are never more than 1 mm in one another, nor deeper than they are now: fingers that have pressed may have
    been pushed into each other a little, since the simulation knows no contacts between links.
    All digits open at once if that is clean, else one of them before the others, or after them.
    """
    opened = state_space(hand, angles).opened
    paths = [[opened]]
    for digit in hand.fingertips:
        mine = np.zeros(hand.num_joints, dtype=bool)
        for name, joint in zip(hand.link_names, hand.joints, strict=True):
            if joint is not None and joint.index is not None:
                mine[joint.index] |= hand.digit_of_link[name] == digit
        paths += [[np.where(mine, opened, angles), opened], [np.where(mine, angles, opened), opened]]
    allowed = max(PENETRATION_LIMIT, float(self_penetration(hand, angles[None])[0]) + OPENING_ALLOWANCE)
    return next((path for path in paths if self_penetration(hand, _between([angles, *path])).max() <= allowed), None)


def _between(path: list[Float[np.ndarray, " joint"]]) -> Float[np.ndarray, "n joint"]:
    """Return joint angles along a path."""
    fractions = np.linspace(0.0, 1.0, OPENING_STEPS)[:, None]
    return np.concatenate([start + fractions * (end - start) for start, end in pairwise(path)])


def _directions(
    hand: Hand, pose: Float[np.ndarray, "4 4"], motion: Float[np.ndarray, " 3"]
) -> list[Float[np.ndarray, " 3"]]:
    back = -pose[:3, :3]
    own = [np.array([0.0, 0.0, 1.0]), back @ hand.finger_axis, back @ hand.palm_normal, motion, -motion]
    sums = own + [one + two for one, two in combinations(own, 2)]
    return [total / np.linalg.norm(total) for total in sums if np.linalg.norm(total) > 0.3]
