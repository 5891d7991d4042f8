"""Whether a hand can move straight from one state to another without touching anything."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.planning.hand_clearance import CAP, NO_STOP, OBSTACLES, Clearances, HandClearance
from dexnudge.planning.hand_motion import State, States, StateSpace, between, matrices
from dexnudge.scenes.scene import Scene

CLEARANCE = 0.003  # [m] kept at every state that is checked
ASSURED = 0.0005  # [m] what is left of it between them, by the bound on how far any point of the hand moves


@dataclass(frozen=True)
class MotionCheck:
    """Checks straight motions so finely that nothing can slip through.

    A state with clearance c vouches for all states to which no point of the hand moves farther than c; where that does not
    cover the motion, its halves are checked. States next to each other are at most 2 (clearance - 0.5 mm)
    apart, 5 mm, in the motion of the hand's fastest point, whatever the clearance.
    """

    space: StateSpace
    measure: HandClearance
    clearance: float = CLEARANCE

    def clearances(self, states: States, *, stop: float = NO_STOP) -> Clearances:
        """Return the least distances to environment and object; see `HandClearance`."""
        return self.measure(states[:, :3], matrices(states), self.space.joint_angles(states[:, 7]), stop=stop)

    def states_free(self, states: States) -> Bool[np.ndarray, " n"]:
        """Return which states keep the clearance."""
        return self.clearances(states, stop=self.clearance).distance.min(axis=1) >= self.clearance

    def free(self, start: State, end: State) -> bool:
        """Return whether the whole straight motion keeps the clearance, both ends included."""
        return self.blocked_at(start, end) is None

    def blocked_at(self, start: State, end: State) -> float | None:
        """Return a fraction of the motion at which the clearance is not kept; None where the motion is free.

        It is that of the coarsest state that shows the obstacle, not of the first along the way.
        """
        way = self.space.displacement(start, end)
        ends = self.states_free(between(start, end, np.array([1.0, 0.0])))
        if not ends.all():
            return 0.0 if not ends[1] else 1.0
        slack = self.clearance - ASSURED
        middle, half = np.array([0.5]), 0.5
        while len(middle):
            distance = self.clearances(between(start, end, middle), stop=self.clearance).distance.min(axis=1)
            if distance.min() < self.clearance:
                return float(middle[np.argmin(distance)])
            needed = half * way
            if needed <= slack:
                return None
            open_yet = middle[np.minimum(distance, CAP) < needed + ASSURED]
            half /= 2
            middle = np.concatenate([open_yet - half, open_yet + half])
        return None


@dataclass(frozen=True)
class Blocked:
    """Why there is no way.

    Attributes:
        stage: "start", "transit", "pre-contact", "contact" or "goal": where on the way it is.
        obstacle: "environment", "object", or "hand" where the hand's own links are in one another.
        link: the hand's link that comes nearest; empty for "hand".
        point: on the obstacle, nearest to that link [m, world]; NaN for "hand".
        clearance: of that link there [m], negative inside.
        reason: one sentence.
    """

    stage: str
    obstacle: str
    link: str
    point: Float[np.ndarray, "3"]
    clearance: float
    reason: str


@dataclass(frozen=True)
class Nearest:
    """The place where a hand is nearest to an obstacle: see `Blocked`; `away`: unit, from the obstacle to the hand."""

    obstacle: str
    link: str
    point: Float[np.ndarray, "3"]
    away: Float[np.ndarray, "3"]
    clearance: float


def nearest_obstacle(
    check: MotionCheck, scene: Scene, where: State, *, among: Sequence[str] = OBSTACLES
) -> Nearest | None:
    """Return what the hand is nearest to in the state `where`; None where all of `among` is beyond `CAP`."""
    found = check.clearances(where[None])
    column = min((OBSTACLES.index(name) for name in among), key=lambda index: found.distance[0, index])
    ball = int(found.nearest[0, column])
    if ball < 0:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrices(where[None])[0], where[:3]
    link, place = check.measure.link_and_point(ball, pose, check.space.joint_angles(where[7:])[0])
    mesh = scene.environment_mesh if OBSTACLES[column] == "environment" else scene.object_in_world()
    hit = ExactDistance(mesh)(place[None])
    gap = place - hit.closest[0]
    length = float(np.linalg.norm(gap))
    away = np.sign(hit.distance[0]) * gap / length if length > 0 else hit.normal[0]
    return Nearest(OBSTACLES[column], link, hit.closest[0], away, float(found.distance[0, column]))


def blocked_by(check: MotionCheck, scene: Scene, where: State, *, stage: str, reason: str) -> Blocked:
    """Return what the hand is nearest to in the state `where`, which is known to be blocked."""
    near = nearest_obstacle(check, scene, where)
    assert near is not None
    return Blocked(stage, near.obstacle, near.link, near.point, near.clearance, reason)


def blocked_by_itself(stage: str, depth: float) -> Blocked:
    """Return that the hand's links are `depth` [m] in one another."""
    return Blocked(
        stage, "hand", "", np.full(3, np.nan), -depth, f"the hand's links are {1e3 * depth:.1f} mm in one another"
    )
