"""Where a hand waits before it closes in on the object, and the straight way from there to contact."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HAND_CONTACT_DISTANCE, hand_contacts
from dexnudge.planning.hand_clearance import MotionCheck, nearest_obstacle
from dexnudge.planning.hand_motion import State, States, StateSpace, between, palm_pose, state
from dexnudge.scenes.scene import Scene

BACK_OFF = (0.02, 0.03, 0.01, 0.005)  # [m] along the straight way, the preferred one first
SHORT, SHORT_COST = 0.01, 1.0  # [m] a shorter way is taken where there is no room for more
OPENINGS = (0.0, 0.1, 0.2, 0.35, 0.5)  # of the way to the open hand
STRETCH_STEP = 0.002  # [m] of the fastest point between two states of the last stretch
# Of the clearance, kept from the environment on the last stretch as far as the goal keeps it: an edge could dig in between
# the hand's points. The object may be touched.
STRETCH_SHARE = 2 / 3
GOAL_ALLOWANCE = 0.0002  # [m] by which the last stretch may be closer than the goal itself: lattice and rounding
NEAR_ENVIRONMENT = 0.02  # [m] to the surroundings, within which moving away from them is tried too
WANTED = 6  # pre-contact states offered to the planner
TRIED = 40  # last stretches looked at to find them
OPENING_COST, ASIDE_COST, DISTANCE_COST = 1.0, 0.5, 5.0  # order of preference, per unit, per (1 - cosine), per metre


@dataclass(frozen=True)
class Stuck:
    """The state nearest to being a pre-contact one, where there is none.

    stage: "pre-contact" when it is the waiting state itself, "contact" when it lies on the last stretch.
    """

    where: State
    stage: str


def _contact_normals(hand: Hand, scene: Scene, q: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "contact 3"]:
    """Return the object's outward unit normals at its contacts with the hand, world."""
    T = hand.forward_kinematics(torch.as_tensor(q[None], dtype=torch.float64))[0].numpy()
    dense = hand.dense_points
    rotation = T[dense.link, :3, :3]
    points = np.einsum("pij,pj->pi", rotation, dense.points) + T[dense.link, :3, 3]
    mesh = scene.object_in_world()
    low, high = mesh.bounds
    near = ((points >= low - HAND_CONTACT_DISTANCE) & (points <= high + HAND_CONTACT_DISTANCE)).all(axis=1)
    hit = ExactDistance(mesh)(points[near])
    normals = np.einsum("pij,pj->pi", rotation[near], dense.normals[near])
    return hand_contacts(
        normals, dense.link[near], distance=hit.distance, closest=hit.closest, object_normals=hit.normal
    ).normals


def back_off_directions(
    hand: Hand, scene: Scene, check: MotionCheck[StateSpace], q: Float[np.ndarray, " coordinates"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Return unit directions in which the hand could draw back, world, and their cosines with the contact normals' mean.

    The mean of the contact normals, up, along the fingers backward, back of the hand first, the scene's motion, away from
    the surroundings where they are within 2 cm, and the sums of two and three of them. Where nothing touches or the
    normals cancel, away from the object's centre stands for their mean.
    """
    normals = _contact_normals(hand, scene, q)
    pose = palm_pose(q)
    away = pose[:3, 3] - scene.object_in_world().bounds.mean(axis=0)
    mean = normals.mean(axis=0) if len(normals) else np.zeros(3)
    if np.linalg.norm(mean) < 0.1:  # opposite contacts cancel
        mean = away
    mean = mean / max(float(np.linalg.norm(mean)), 1e-9)
    back = -pose[:3, :3]
    own = [mean, np.array([0.0, 0.0, 1.0]), back @ hand.finger_axis, back @ hand.palm_normal, scene.motion]
    nearest = nearest_obstacle(check, scene, state(pose, 0.0), among=("environment",))
    if nearest is not None and nearest[3] < NEAR_ENVIRONMENT:
        own.append(nearest[4])
    sums = [sum(parts) for count in (1, 2, 3) for parts in combinations(own, count)]
    directions = np.array([total for total in sums if np.linalg.norm(total) > 0.3])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions, directions @ mean


def pre_contacts(
    check: MotionCheck[StateSpace], goal: State, directions: Float[np.ndarray, "n 3"], cosines: Float[np.ndarray, " n"]
) -> States | Stuck:
    """Return states that keep the clearance and lead straight to `goal`, most preferred first.

    They are 10 to 30 mm back along one of `directions` (see `back_off_directions`), 5 mm where there is no more room; the
    fingers are opened where that is needed.
    """
    candidates, cost = [], []
    for opening in OPENINGS:
        for distance in BACK_OFF:
            for direction, aligned in zip(directions, cosines, strict=True):
                candidate = goal.copy()
                candidate[:3] += distance * direction
                candidate[7] = opening
                candidates.append(candidate)
                short = SHORT_COST * (distance < SHORT)
                aside = ASIDE_COST * (1 - aligned)
                cost.append(OPENING_COST * opening + aside + short + DISTANCE_COST * abs(distance - BACK_OFF[0]))
    order = np.argsort(cost, kind="stable")
    states = np.array(candidates)[order]
    distance = check.clearances(states, stop=check.clearance).distance.min(axis=1)
    free = np.flatnonzero(distance >= check.clearance)
    if len(free) == 0:
        return Stuck(states[int(np.argmax(distance))], "pre-contact")
    # Of environment and object, on the last stretch.
    floor = np.minimum(
        [STRETCH_SHARE * check.clearance, 0.0], check.clearances(goal[None]).distance[0] - GOAL_ALLOWANCE
    )
    found, stuck = [], None
    for index in free[:TRIED]:
        blocked = blocked_on_stretch(check, states[index], goal, floor=floor)
        if blocked is None:
            found.append(states[index])
            if len(found) == WANTED:
                break
        elif stuck is None:
            stuck = blocked
    return np.array(found) if stuck is None or found else Stuck(stuck, "contact")


def blocked_on_stretch(
    check: MotionCheck[StateSpace], start: State, goal: State, *, floor: Float[np.ndarray, "2"]
) -> State | None:
    """Return the first state on the straight way to contact that is nearer than `floor` [m]; None where there is none."""
    count = int(np.ceil(check.space.displacement(start, goal) / STRETCH_STEP))
    states = between(start, goal, np.linspace(0.0, 1.0, count + 1))
    near = (check.clearances(states, stop=float(floor.min())).distance < floor).any(axis=1)
    return states[np.argmax(near)] if near.any() else None
