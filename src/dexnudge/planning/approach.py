"""A way for the hand from outside the surroundings to contact with the object, without touching anything before."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Bool, Float

from dexnudge.errors import InputError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.contacts import HAND_CONTACT_DISTANCE, contacts_of_hands
from dexnudge.planning.connect import connect, outside_states
from dexnudge.planning.hand_clearance import (
    CLEARANCE,
    Blocked,
    HandClearance,
    MotionCheck,
    blocked_by_itself,
    nearest_obstacle,
)
from dexnudge.planning.hand_motion import (
    State,
    States,
    StateSpace,
    Trajectory,
    between,
    joined,
    palm_pose,
    state,
    state_space,
    timed,
)
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import PENETRATION_LIMIT
from dexnudge.verification.penetration import self_penetration

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
    [contacts] = contacts_of_hands(
        np.zeros(near.sum(), dtype=np.int64),
        np.einsum("pij,pj->pi", rotation[near], dense.normals[near]),
        dense.link[near],
        num_hands=1,
        distance=hit.distance,
        closest=hit.closest,
        object_normals=hit.normal,
    )
    return contacts.normals


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


CLEARANCES = (CLEARANCE, 0.002, 0.0015)  # [m] kept on the way, the less the nearer the goal is to its surroundings
BUDGET = 20_000  # states that the planner may look at; one takes 10 microseconds to a millisecond
OPENING_PENETRATION = 0.0008  # [m] in itself while the hand opens: below what a configuration may have
OPENING_ALLOWANCE = 0.00005  # [m] where the goal itself is deeper: rounding
OPENING_STEPS = 33  # openings at which the hand is tested against itself
STRAIGHT_TRIES = 24  # straight ways from outside that are tried before the planner is asked
MOST_STARTS = 6  # outside states offered to the planner


@dataclass(frozen=True)
class Approach:
    """A way from outside, or from the given start, to the goal.

    pre_contact_time: when the straight last stretch begins [s]. planner: "straight" when no way around anything was needed,
    else "RRT-Connect".
    """

    trajectory: Trajectory
    pre_contact_time: float
    planner: str

    @property
    def transit(self) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "sample coordinates"]]:
        """Times [s] and q up to pre-contact."""
        early = self.trajectory.times <= self.trajectory.times[self._late][0]
        return self.trajectory.times[early], self.trajectory.q[early]

    @property
    def last_stretch(self) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "sample coordinates"]]:
        """Times [s, from 0] and q from pre-contact to contact."""
        times = self.trajectory.times[self._late]
        return times - times[0], self.trajectory.q[self._late]

    @property
    def _late(self) -> Bool[np.ndarray, " whole"]:
        return self.trajectory.times >= self.pre_contact_time - 1e-9


@dataclass(frozen=True)
class Waiting:
    """Places before contact.

    check: of the hand's motions, with the clearance that was found. goal: at contact. states: free ones with a straight way
    to the goal, most preferred first. directions: unit ones in which they were looked for.
    """

    check: MotionCheck[StateSpace]
    goal: State
    states: States
    directions: Float[np.ndarray, "direction 3"]


class ApproachPlanner:
    """Plans approaches of one hand in one scene, the object being at rest; make it once for many configurations."""

    def __init__(self, hand: Hand, scene: Scene) -> None:
        self.hand, self.scene = hand, scene
        self._measure = HandClearance(hand, scene)

    def plan(
        self,
        q: Float[np.ndarray, " coordinates"],
        *,
        start: Float[np.ndarray, " coordinates"] | None = None,
        seed: int = 0,
        budget: int = BUDGET,
    ) -> Approach | Blocked:
        """Plan a way to the configuration `q`, or say what stands in the way.

        First straight ways from states outside (see `outside_states`) to pre-contact states (see `pre_contacts`), then
        RRT-Connect between them. The hand keeps 3 mm from everything until pre-contact, 1.5 mm where there is no
        more room (between the states that are looked at, 0.5 mm are assured), then goes straight to `q`.

        q and `start`, where the hand is now (None: any state outside), are configurations (9 + d,), world. RRT-Connect may
        look at `budget` states.

        Raises:
            InputError: `q` or `start` has the wrong length or is not finite.
        """
        found = self.waiting(q)
        if isinstance(found, Blocked):
            return found
        check, goal, waiting, space = found.check, found.goal, found.states, found.check.space
        before: Trajectory | None = None
        if start is None:
            starts, ends = outside_states(self.scene, check, waiting, directions=found.directions)
            if len(starts) == 0:
                reason = "no free place outside the surroundings within 0.6 m"
                return self._blocked(check, waiting[0], "start", reason)
        else:
            start = self._configuration("start", start)
            opening = self._opening(check, start)
            if isinstance(opening, Blocked):
                return opening
            before = opening
            starts, ends = np.repeat(state(palm_pose(start), 1.0)[None], len(waiting), axis=0), waiting
        path, planner = self._transit(check, starts, ends, waiting, seed, budget)
        if path is None:
            where = between(starts[0], ends[0], np.array([check.blocked_at(starts[0], ends[0]) or 0.0]))
            return self._blocked(check, where[0], "transit", f"no way found within {budget} states")
        states = np.concatenate([path, goal[None]])
        whole = joined(before, timed(space, states, contact_from=len(path) - 1))
        last_stretch = timed(space, states[-2:], contact_from=0).duration
        return Approach(whole, float(whole.times[-1] - last_stretch), planner)

    def waiting(self, q: Float[np.ndarray, " coordinates"]) -> "Waiting | Blocked":
        """Return where the hand may wait before it goes straight to the configuration `q`, or say what stands in the way.

        Raises:
            InputError: `q` has the wrong length or is not finite.
        """
        q = self._configuration("q", q)
        space, own_depth = self._space(q[ROOT_COORDINATES:])
        if own_depth > PENETRATION_LIMIT:
            return blocked_by_itself("goal", own_depth)
        check, goal = MotionCheck(space, self._measure), state(palm_pose(q), 0.0)
        if check.clearances(goal[None], stop=-PENETRATION_LIMIT).distance.min() < -PENETRATION_LIMIT:
            return self._blocked(check, goal, "goal", "the configuration itself penetrates by more than 1 mm")
        directions, cosines = back_off_directions(self.hand, self.scene, check, q)
        for clearance in CLEARANCES:
            check = MotionCheck(space, self._measure, clearance)
            found = pre_contacts(check, goal, directions, cosines)
            if not isinstance(found, Stuck):
                return Waiting(check, goal, found, directions)
        assert isinstance(found, Stuck)
        return self._blocked(check, found.where, found.stage, "no straight way of 5 to 30 mm leads to contact")

    @staticmethod
    def _transit(
        check: MotionCheck[StateSpace], starts: States, ends: States, goals: States, seed: int, budget: int
    ) -> tuple[States | None, str]:
        for begin, end in list(zip(starts, ends, strict=True))[:STRAIGHT_TRIES]:
            if check.free(begin, end):
                return np.stack([begin, end]), "straight"
        unique = np.unique(starts[:MOST_STARTS], axis=0)
        return connect(check, unique, goals, seed=seed, budget=budget), "RRT-Connect"

    def _space(self, closed: np.ndarray) -> tuple[StateSpace, float]:
        """Return the states of a hand that closes to these angles and opens until it would touch itself; its depth now."""
        space = state_space(self.hand, closed)
        openings = np.linspace(0.0, 1.0, OPENING_STEPS)
        depth = self_penetration(self.hand, space.joint_angles(openings))
        too_deep = np.flatnonzero(depth > max(OPENING_PENETRATION, depth[0] + OPENING_ALLOWANCE))
        largest = openings[too_deep[0] - 1] if len(too_deep) else 1.0
        if largest == 1.0:
            return space, float(depth[0])
        opened = space.joint_angles(np.array([largest]))[0]
        return replace(space, opened=opened, sweep=space.sweep * largest), float(depth[0])

    def _opening(self, check: MotionCheck[StateSpace], start: np.ndarray) -> Trajectory | Blocked:
        """Return the motion of the fingers alone at `start`, as far open as on the way that follows."""
        here = state(palm_pose(start), 1.0)
        own = state_space(self.hand, start[ROOT_COORDINATES:])
        own = replace(own, opened=check.space.opened, sweep=own.sweep + check.space.sweep)
        fingers = MotionCheck(own, self._measure)
        closed = here.copy()
        closed[7] = 0.0
        blocked = fingers.blocked_at(closed, here)
        if blocked is not None:
            closed[7] = blocked
            return self._blocked(fingers, closed, "start", "the hand cannot open its fingers where it starts")
        depth = float(self_penetration(self.hand, own.joint_angles(np.linspace(0.0, 1.0, OPENING_STEPS))).max())
        if depth > PENETRATION_LIMIT:
            return blocked_by_itself("start", depth)
        return timed(own, np.stack([closed, here]), contact_from=2)

    def _blocked(self, check: MotionCheck[StateSpace], where: State, stage: str, reason: str) -> Blocked:
        """Return what the hand is nearest to in the state `where`, which is known to be blocked."""
        near = nearest_obstacle(check, self.scene, where)
        assert near is not None
        return Blocked(stage, *near[:4], reason)

    def _configuration(self, name: str, q: np.ndarray) -> Float[np.ndarray, " coordinates"]:
        q = np.asarray(q, dtype=np.float64)
        expected = (ROOT_COORDINATES + self.hand.num_joints,)
        if q.shape != expected or not np.isfinite(q).all():
            raise InputError(f"{name} has shape {q.shape}; expected {expected}, finite numbers")
        return q
