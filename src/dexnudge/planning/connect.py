"""A way around obstacles by OMPL's RRT-Connect (Kuffner and LaValle, ICRA 2000), shortened afterwards."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.planning.hand_clearance import MotionCheck
from dexnudge.planning.hand_motion import QUATERNION, State, States, StateSpace
from dexnudge.scenes.scene import Scene

GAP = 0.05  # [m] between the hand and the bounding box of surroundings and object
FARTHEST = 0.6  # [m] in a room, which no hand leaves, the way begins this far from where it ends
START_CLEARANCE = 0.02  # [m] of the whole hand
BELOW = -0.5  # z of a direction below which it is tried last: arms come from above or from a side

AXES = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], dtype=float)


def outside_states(
    scene: Scene,
    check: MotionCheck[StateSpace],
    waiting: States,
    *,
    directions: Float[np.ndarray, "direction 3"],
) -> tuple[States, States]:
    """Return free states outside, with open fingers, and the state of `waiting` that each was moved out from, nearest first.

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
    """Return the distance along `direction` to where it leaves the box [m]; 0 from outside."""
    if (point < low).any() or (point > high).any():
        return 0.0
    moving = np.abs(direction) > 1e-9
    face = np.where(direction > 0, high, low)
    return float(((face - point)[moving] / direction[moving]).min())


RANGE = 0.25  # longest extension of a tree, in the metric below
TURN_WEIGHT = 0.2  # [m/rad] a radian counts as much as 0.2 m, the way of a fingertip
OPENING_WEIGHT = 0.1  # [m] opening the whole hand counts as much as this
ROOM = 0.50  # [m] around all starts and goals in which ways are sought
SHORTCUTS = 60  # attempts at shortening what was found
SNAP = 0.005  # of the path: a shortcut's end this close to a vertex begins there
SHORTCUT_RANGE = 0.5  # of the path, spanned by one shortcut at most


def connect(check: MotionCheck[StateSpace], starts: States, goals: States, *, seed: int, budget: int) -> States | None:
    """Plan a path of free straight motions of a hand; see `connect_in`."""
    _check_ompl()
    from ompl import base

    both = np.concatenate([starts, goals])[:, :3]
    space = base.CompoundStateSpace()
    space.addSubspace(_box(base, both.min(axis=0) - ROOM, both.max(axis=0) + ROOM), 1.0)
    space.addSubspace(base.SO3StateSpace(), TURN_WEIGHT)
    space.addSubspace(_box(base, np.zeros(1), np.ones(1)), OPENING_WEIGHT)
    return connect_in(PlanningSpace(space, _read, _written, RANGE), check, starts, goals, seed=seed, budget=budget)


@dataclass(frozen=True)
class PlanningSpace:
    """A space in OMPL's terms.

    space: OMPL's. read, written: from OMPL's state to a row of numbers, and back into an OMPL state. range: longest
    extension of a tree, in the metric of the space.
    """

    space: Any
    read: Callable[[Any], Float[np.ndarray, " state"]]
    written: Callable[[Any, Float[np.ndarray, " state"]], Any]
    range: float


def box_space(low: Float[np.ndarray, " n"], high: Float[np.ndarray, " n"], *, longest: float) -> PlanningSpace:
    """Return the space of rows of n numbers between two corners, whose trees grow by `longest` at a time."""

    def read(one: Any) -> Float[np.ndarray, " n"]:
        return np.array(one[0 : len(low)])

    def written(one: Any, values: Float[np.ndarray, " n"]) -> Any:
        for axis, value in enumerate(values.tolist()):
            one[axis] = value
        return one

    _check_ompl()
    from ompl import base

    return PlanningSpace(_box(base, low, high), read, written, longest)


def connect_in(
    planned: PlanningSpace,
    check: MotionCheck[Any],
    starts: Float[np.ndarray, "start state"],
    goals: Float[np.ndarray, "goal state"],
    *,
    seed: int,
    budget: int,
) -> Float[np.ndarray, "vertex state"] | None:
    """Plan a path of free straight motions from one of `starts` to one of `goals`; None where the budget runs out.

    All starts and goals must be free, at least one of each. The same seed gives the same path: OMPL has one seed for the
    process, which is set anew on each call; so this is not for several threads of one process. `budget` is in states that
    are looked at, counted by `check.measure`.

    Raises:
        InputError: OMPL is not installed.
    """
    _check_ompl()
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)  # it objects to a second seed, which is what makes each call repeatable
    last = check.measure.count + budget
    util.RNG.setSeed(seed + 1)  # 0 would mean a seed from the clock
    space, read, written = planned.space, planned.read, planned.written
    information = base.SpaceInformation(space)

    class Validator(base.MotionValidator):
        """Asks `check`; with the budget spent nothing is free, so that shortening ends too."""

        def checkMotion(self, first: Any, second: Any) -> bool:
            return check.measure.count < last and check.free(read(first), read(second))

    validator = Validator(information)
    information.setMotionValidator(validator)
    information.setStateValidityChecker(lambda one: bool(check.states_free(read(one)[None])[0]))
    information.setup()
    problem = base.ProblemDefinition(information)
    for start in starts:
        problem.addStartState(written(space.allocState(), start))
    wanted = base.GoalStates(information)
    for goal in goals:
        wanted.addState(written(space.allocState(), goal))
    problem.setGoal(wanted)
    planner = geometric.RRTConnect(information)
    planner.setRange(planned.range)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(lambda: check.measure.count >= last))
    if not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    last = check.measure.count + budget
    util.RNG.setSeed(seed + 1)
    simplifier = geometric.PathSimplifier(information)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, SHORTCUTS, SHORTCUTS, SHORTCUT_RANGE, SNAP)
    simplifier.reduceVertices(path)
    return np.array([read(one) for one in path.getStates()])


def _check_ompl() -> None:
    if find_spec("ompl") is None:
        raise InputError(
            "the package ompl is not installed; expected it for ways around obstacles; pip install ompl (Linux, macOS 15 "
            "or later)"
        )


def _box(base: Any, low: np.ndarray, high: np.ndarray) -> Any:
    """Return OMPL's space of real vectors between two corners."""
    box, bounds = base.RealVectorStateSpace(len(low)), base.RealVectorBounds(len(low))
    for axis in range(len(low)):
        bounds.setLow(axis, float(low[axis]))
        bounds.setHigh(axis, float(high[axis]))
    box.setBounds(bounds)
    return box


def _read(one: Any) -> State:
    turn = one[1]
    return np.array([*one[0][:3], turn.w, turn.x, turn.y, turn.z, one[2][0]])


def _written(one: Any, values: State) -> Any:
    for axis in range(3):
        one[0][axis] = float(values[axis])
    one[1].w, one[1].x, one[1].y, one[1].z = (float(value) for value in values[QUATERNION])
    one[2][0] = float(values[7])
    return one
