"""What stands in a hand's way: which body, where, and which link of the hand is next to it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.planning.hand_clearance import OBSTACLES
from dexnudge.planning.hand_states import State, matrices
from dexnudge.planning.motion_check import MotionCheck
from dexnudge.scenes.scene import Scene


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
    """What the hand is nearest to in the state `where`; None where all of `among` is beyond `CAP`."""
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
    """What the hand is nearest to in the state `where`, which is known to be blocked."""
    near = nearest_obstacle(check, scene, where)
    assert near is not None
    return Blocked(stage, near.obstacle, near.link, near.point, near.clearance, reason)


def blocked_by_itself(stage: str, depth: float) -> Blocked:
    """The hand's links are `depth` [m] in one another."""
    return Blocked(
        stage, "hand", "", np.full(3, np.nan), -depth, f"the hand's links are {1e3 * depth:.1f} mm in one another"
    )
