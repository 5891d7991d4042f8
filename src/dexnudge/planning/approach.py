"""A way for the hand from outside the surroundings to contact with the object, without touching anything before."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.errors import InputError
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.planning.connect import connect, outside_states
from dexnudge.planning.hand_clearance import (
    CLEARANCE,
    Blocked,
    HandClearance,
    MotionCheck,
    blocked_by,
    blocked_by_itself,
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
from dexnudge.planning.pre_contact import Stuck, back_off_directions, pre_contacts
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import PENETRATION_LIMIT
from dexnudge.verification.penetration import self_penetration

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

    space: of the hand's states. check: of its motions, with the clearance that was found. goal: at contact. states: free
    ones with a straight way to the goal, most preferred first. directions: unit ones in which they were looked for.
    """

    space: StateSpace
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
        check, goal, waiting, space = found.check, found.goal, found.states, found.space
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
                return Waiting(space, check, goal, found, directions)
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
        return blocked_by(check, self.scene, where, stage=stage, reason=reason)

    def _configuration(self, name: str, q: np.ndarray) -> Float[np.ndarray, " coordinates"]:
        q = np.asarray(q, dtype=np.float64)
        expected = (ROOT_COORDINATES + self.hand.num_joints,)
        if q.shape != expected or not np.isfinite(q).all():
            raise InputError(f"{name} has shape {q.shape}; expected {expected}, finite numbers")
        return q
