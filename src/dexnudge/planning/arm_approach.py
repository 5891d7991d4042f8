"""An arm's way from where it is to a configuration of its hand, touching nothing.

The hand goes the last centimetres straight (`pre_contact`), and comes to there from the open straight or around what is in
its way (`exits`); the arm follows by inverse kinematics. Into the open it goes by RRT-Connect in joint space.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from dexnudge.arms.inverse_kinematics import InverseKinematics
from dexnudge.arms.robot import Robot
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.planning.approach import ApproachPlanner, Waiting
from dexnudge.planning.connect import box_space, connect, connect_in
from dexnudge.planning.hand_clearance import CLEARANCE, Blocked, MotionCheck
from dexnudge.planning.hand_motion import State, States, StateSpace, between, matrices
from dexnudge.planning.robot_motion import RobotClearance, RobotSpace
from dexnudge.scenes.scene import Scene

STARTS = 24  # of inverse kinematics at contact
ALIKE = 0.05  # [rad] solutions that are nearer than this are one
STRETCH_SPACING, EXIT_SPACING = 0.004, 0.010  # [m] between stations
MOST_EXITS = 8  # of the hand that are followed for each solution
ENTRIES = 2  # free ones of each solution that the planner may choose from
RANGE = 0.8  # [rad] longest extension of a tree
BUDGET = 40_000  # states of the robot that RRT-Connect may look at; one takes 50 microseconds
ROUNDING = 0.0002  # [m] by which inverse kinematics may bring the hand nearer than where it was found free


@dataclass(frozen=True)
class NoWay:
    """Why there is none: the phase of the plan that failed, and the reason, a sentence without its end."""

    phase: str
    reason: str


@dataclass(frozen=True)
class Entry:
    """A way of arm and hand between contact and the open, from contact outward.

    stretch: positions from contact to where the hand waits. exit: from there into the open. opening: of the hand there.
    """

    stretch: Float[np.ndarray, "near joint"]
    exit: Float[np.ndarray, "far joint"]
    opening: float


@dataclass(frozen=True)
class HandWays:
    """Where the hand waits before contact, and ways from the open to there, states of the hand."""

    waiting: Waiting
    ways: Sequence[States]


class ArmApproach:
    """Plans for one robot in one scene, the object at rest; make it once for many configurations.

    contact, before: what the phases at contact and before it are called in reasons.
    """

    def __init__(
        self, robot: Robot, scene: Scene, *, contact: str = "contact", before: str = "pre-contact", seed: int = 0
    ) -> None:
        self.robot, self.scene, self._seed = robot, scene, seed
        self._contact, self._before = contact, before
        self._kinematics = InverseKinematics(robot.arm)
        self._approach = ApproachPlanner(robot.hand, scene)
        self.clearance = RobotClearance(robot, scene)
        self._arm = RobotClearance(robot, scene, hand=False)

    def to(
        self, q: Float[np.ndarray, " coordinates"], *, start: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "vertex joint"], Entry] | NoWay:
        """Return vertices of straight motions in joint space from the arm's joint angles `start`, and how they go on."""
        hand = self.hand_ways(q)
        if isinstance(hand, NoWay):
            return hand
        solved = self.solutions(q)
        if not len(solved):
            return NoWay(self._contact, "out of reach")
        failed = NoWay(self._contact, "")
        found: list[Entry] = []
        for angles in solved:
            entries = self.entries(hand, np.concatenate([angles, q[ROOT_COORDINATES:]]))
            failed, found = (entries, found) if isinstance(entries, NoWay) else (failed, found + entries)
        way = self.transit(hand.waiting, start, found) if found else failed
        return way if isinstance(way, NoWay) else (way[0], found[way[1]])

    def hand_ways(self, q: Float[np.ndarray, " coordinates"]) -> HandWays | NoWay:
        """Return the ways of the hand alone to q (world), or why there are none."""
        waiting = self._approach.waiting(q)
        if isinstance(waiting, Blocked):
            met = f": '{waiting.link}' meets the {waiting.obstacle}" if waiting.link else ""
            return NoWay(self._contact, waiting.reason + met)
        ways = exits(self.robot.hand, self.scene, waiting, seed=self._seed)
        if not ways:
            return NoWay(self._before, "the hand finds no way between the open and the object")
        return HandWays(waiting, ways[:MOST_EXITS])

    def solutions(self, q: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "solution n"]:
        """Return different joint angles of the arm that bring the hand to q; none where it is out of reach."""
        pose = np.repeat(self.robot.flange_poses(q[None]), STARTS, axis=0)
        found = self._kinematics.solve_all(pose, self._kinematics.starts(STARTS))
        kept: list[np.ndarray] = []
        for one in found.positions[found.solved]:
            if all(np.abs(one - other).max() > ALIKE for other in kept):
                kept.append(one)
        return np.array(kept).reshape(-1, self.robot.arm.num_joints)

    def followed(
        self, q: Float[np.ndarray, "way station coordinates"], start: Float[np.ndarray, "way n"]
    ) -> tuple[Float[np.ndarray, "way station joint"], Int[np.ndarray, " way"]]:
        """Return positions at which the hand stands at q, station by station from near `start`, and how many are reached."""
        flange = np.array([self.robot.flange_poses(way) for way in q])
        angles, reached = follow(self._kinematics, flange, start)
        return np.concatenate([angles, q[:, :, ROOT_COORDINATES:]], axis=2), reached.sum(axis=1)

    def what_blocks(self, positions: Float[np.ndarray, "k joint"]) -> str:
        """Return what the arm meets at positions, in words; "" where it keeps its clearance."""
        clearance = self._arm.of(positions, stop=CLEARANCE)
        return self._arm.what_blocks(positions[int(clearance.argmin())]) if clearance.min() < CLEARANCE else ""

    def entries(self, hand: HandWays, contact: Float[np.ndarray, " joint"]) -> list[Entry] | NoWay:
        """Return the ways of the hand on which the arm can follow it from its position at contact.

        Where it can follow none into the open, those that come farthest: the rest is the planner's in joint space.
        """
        space, goal = hand.waiting.check.space, hand.waiting.goal
        stretches = _alike([stations(space, [goal, way[-1]], spacing=STRETCH_SPACING) for way in hand.ways])
        outs = _alike([stations(space, way[::-1], spacing=EXIT_SPACING) for way in hand.ways])
        states, split = np.concatenate([stretches, outs[:, 1:]], axis=1), stretches.shape[1]
        q = np.array([space.configurations(each) for each in states])
        start = np.repeat(contact[None, : self.robot.arm.num_joints], len(q), axis=0)
        positions, reached = self.followed(q, start)
        positions[:, 0] = contact
        found: list[Entry] = []
        short: list[Entry] = []
        failed = NoWay(self._contact, "")
        for way, count, path in zip(positions, reached.tolist(), states, strict=True):
            near = np.flatnonzero(self._arm.of(way[:count], stop=CLEARANCE) < CLEARANCE)
            end = int(near[0]) if len(near) else count
            if end < split:
                phase = self._contact if count < split else self._before
                what = self._arm.what_blocks(way[end]) if len(near) else "the arm cannot follow the hand"
                failed = NoWay(phase, what)
                continue
            entry = Entry(way[:split], way[split - 1 : end], float(path[end - 1][7]))
            (found if end == len(way) else short).append(entry)
            if len(found) == ENTRIES:
                break
        short.sort(key=lambda entry: -len(entry.exit))
        return [*found, *short[: ENTRIES - len(found)]] or failed

    def transit(
        self, waiting: Waiting, start: Float[np.ndarray, " n"], entries: Sequence[Entry]
    ) -> tuple[Float[np.ndarray, "vertex joint"], int] | NoWay:
        """Return vertices from the arm's joint angles `start`, its hand open, to the end of an entry, and of which."""
        arm = self.robot.arm
        space, begin = RobotSpace(self.robot, waiting.check.space), np.append(start, 1.0)
        check = MotionCheck(space, self.clearance, waiting.check.clearance - ROUNDING)
        goals = np.array([np.append(entry.exit[-1][: arm.num_joints], entry.opening) for entry in entries])
        if not check.states_free(begin[None])[0]:
            what = self.clearance.what_blocks(space.positions(begin[None])[0])
            return NoWay(self._before, f"it is not free at home: {what}")
        free = np.flatnonzero(check.states_free(goals))
        if not len(free):
            return NoWay(self._before, self.clearance.what_blocks(space.positions(goals[:1])[0]))
        path = next((np.stack([begin, goals[row]]) for row in free if check.free(begin, goals[row])), None)
        if path is None:
            box = box_space(np.append(arm.limits.lower, 0.0), np.append(arm.limits.upper, 1.0), longest=RANGE)
            path = connect_in(box, check, begin[None], goals[free], seed=self._seed, budget=BUDGET)
        if path is None:
            return NoWay(self._before, f"the arm finds no way between home and the open in {BUDGET} states")
        return space.positions(path), int(free[np.abs(goals[free] - path[-1]).max(axis=1).argmin()])


def _alike(ways: list[States]) -> Float[np.ndarray, "way station 8"]:
    """Return ways with as many stations as the longest has."""
    longest = max(len(way) for way in ways)
    return np.array([evenly(way, longest) for way in ways])


# [rad] of a joint from one station to the next: more is a jump to another branch, or a singularity.
LARGEST_CHANGE = 0.20
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


OPEN = 0.03  # [m] of clearance with which a hand counts as being in the open
FARTHEST = 0.50  # [m] from where it waits
STEP = 0.02  # [m] between the places that are looked at
BELOW = -0.3  # z of a direction below which it is not tried: arms come from above or from a side
MOST_WAITING = 4  # places that are looked at, the preferred ones first
MOST_ENDS = 6  # in the open, of straight ways that are blocked, to which a way around is sought
EXIT_BUDGET = 6_000  # states of the hand that RRT-Connect may look at


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
    around = connect(waiting.check, ends, waiting.states, seed=seed, budget=EXIT_BUDGET)
    return [] if around is None else [around]


def _directions(
    hand: Hand, rotation: Float[np.ndarray, "3 3"], motion: Float[np.ndarray, " 3"]
) -> list[Float[np.ndarray, " 3"]]:
    own = [motion, np.array([0.0, 0.0, 1.0]), -rotation @ hand.finger_axis, -rotation @ hand.palm_normal]
    sums = own + [one + two for one, two in combinations(own, 2)]
    units = [total / np.linalg.norm(total) for total in sums if np.linalg.norm(total) > 0.3]
    return [unit for unit in units if unit[2] > BELOW]
