"""How far a hand is from the surroundings and from the object at rest, and whether it can move straight between states."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import ROOT_COORDINATES, Hand, LinkPoints
from dexnudge.hands.kinematics import kinematic_tree
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.planning.clearance_kernel import (
    ClearanceHand,
    HandStates,
    Obstacle,
    PointBalls,
    clearances,
    joined_balls,
    point_balls,
)
from dexnudge.planning.hand_motion import State, StateSpace, palm_pose
from dexnudge.scenes.scene import Scene

CAP = 0.10  # [m] clearances are measured up to here; beyond, all that counts is that it is far
BATCH = 128  # states of one launch; the buffers are that long
NO_STOP = -1.0e3  # [m] below every distance: the walk goes on until the least one is found
OBSTACLES: tuple[str, str] = ("environment", "object")  # columns of what the kernel returns
CLEARANCE = 0.003  # [m] kept at every state that is checked
PADDING = 0.007  # [m] of an arm's links, besides that clearance: what is sharp fits between points 8 mm apart
ASSURED = 0.0005  # [m] what is left of it between them, by the bound on how far any point of the hand moves


@dataclass(frozen=True)
class Clearances:
    """Least signed distance of the hand's surface points to each obstacle [m], at most `CAP`; negative inside.

    `nearest`: index of the ball whose centre is that point, -1 beyond the cap. Columns as in `OBSTACLES`.
    """

    distance: Float[np.ndarray, "n obstacle"]
    nearest: Int[np.ndarray, "n obstacle"]


class HandClearance:
    """Measures clearances of one hand, its base included, in one scene; exact for the hand's dense points (2 mm).

    Signed distance, negative inside. One core; some 10 to 100 microseconds a state in free space, up to a
    millisecond where fingers surround the object.
    """

    def __init__(self, hand: Hand, scene: Scene) -> None:
        self.hand = hand
        self.count = 0
        """States measured so far: what a budget is counted in, since it is the same on every machine."""
        self.origin = scene.T_world_object[:3, 3].copy()  # single precision is finest near the object
        self._model = _model(hand)
        self._trees, obstacles = _obstacles(scene)  # the kernel holds only the trees' numbers
        links, joints = len(hand.link_names), hand.num_joints
        self._arrays = {
            "translation": np.zeros((BATCH, 3), np.float32),
            "rotation": np.zeros((BATCH, 3, 3), np.float32),
            "joint_angles": np.zeros((BATCH, joints), np.float32),
            "link_translation": np.zeros((BATCH, links, 3), np.float32),
            "link_rotation": np.zeros((BATCH, links, 3, 3), np.float32),
            "distance": np.zeros((BATCH, 2), np.float32),
            "nearest": np.zeros((BATCH, 2), np.int32),
        }
        types = {"translation": wp.vec3, "link_translation": wp.vec3, "rotation": wp.mat33, "link_rotation": wp.mat33}
        states = HandStates()
        for name, array in self._arrays.items():
            dtype = types.get(name, wp.int32 if array.dtype == np.int32 else wp.float32)
            setattr(states, name, wp.array(array, dtype=dtype, device="cpu", copy=False))
        inputs = [self._model[0], *obstacles, states, CAP, NO_STOP]
        self._launch = wp.launch(clearances, dim=BATCH, inputs=inputs, device="cpu", record_cmd=True)

    def __call__(
        self,
        translation: Float[np.ndarray, "n 3"],
        rotation: Float[np.ndarray, "n 3 3"],
        joint_angles: Float[np.ndarray, "n joint"],
        *,
        stop: float = NO_STOP,
    ) -> Clearances:
        """Return the clearances of the palm poses (world, [m]) and joint angles [rad].

        A state that comes closer than `stop` [m] is not searched further: its distance is then only known to be
        below `stop`, and that to the object may not have been looked at.
        """
        count = len(translation)
        self.count += count
        distance, nearest = np.zeros((count, 2)), np.zeros((count, 2), dtype=np.int64)
        for first in range(0, count, BATCH):
            rows = slice(first, min(first + BATCH, count))
            size = rows.stop - first
            self._arrays["translation"][:size] = translation[rows] - self.origin
            self._arrays["rotation"][:size] = rotation[rows]
            self._arrays["joint_angles"][:size] = joint_angles[rows]
            self._launch.set_dim(size)
            self._launch.set_param_at_index(5, float(stop))
            self._launch.launch()
            distance[rows] = self._arrays["distance"][:size]
            nearest[rows] = self._arrays["nearest"][:size]
        return Clearances(distance, nearest)

    def shifted(
        self,
        q: Float[np.ndarray, " coordinates"],
        shifts: Float[np.ndarray, "n 3"],
        joint_angles: Float[np.ndarray, "n joint"] | None = None,
        *,
        stop: float = NO_STOP,
    ) -> Clearances:
        """Return the clearances of the hand at q (world) moved by `shifts` [m], with its own joint angles or these."""
        rotation = np.repeat(palm_pose(q)[None, :3, :3], len(shifts), axis=0)
        if joint_angles is None:
            joint_angles = np.repeat(q[None, ROOT_COORDINATES:], len(shifts), axis=0)
        return self(q[:3] + shifts, rotation, joint_angles, stop=stop)

    def link_and_point(self, ball: int, q: Float[np.ndarray, " coordinates"]) -> tuple[str, Float[np.ndarray, "3"]]:
        """Return the name of the link that a ball belongs to and the place of its centre [m, world] for one q."""
        balls = self._model[1]
        link = int(balls.link[ball])
        T_world_link = self.hand.forward_kinematics(torch.as_tensor(q[None], dtype=torch.float64))[0, link].numpy()
        return self.hand.link_names[link], T_world_link[:3, :3] @ balls.point[ball] + T_world_link[:3, 3]


@cached_per_instance
def _obstacles(scene: Scene) -> tuple[list[wp.Mesh], list[WarpStruct]]:
    """Return trees over surroundings and object, and what the kernel is told of them; one of each for all that measure.

    In the frame of the kernel, whose origin is the object's.
    """
    trees, obstacles = [], []
    for mesh in (scene.environment_mesh, scene.object_in_world()):
        vertices = np.asarray(mesh.vertices - scene.T_world_object[:3, 3], dtype=np.float32)
        tree = wp.Mesh(
            points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
            indices=wp.array(np.asarray(mesh.faces, dtype=np.int32).ravel(), dtype=wp.int32, device="cpu"),
            support_winding_number=True,
        )
        obstacle = Obstacle()
        obstacle.mesh = tree.id
        obstacle.low, obstacle.high = (wp.vec3(*end.tolist()) for end in (vertices.min(axis=0), vertices.max(axis=0)))
        trees.append(tree)
        obstacles.append(obstacle)
    return trees, obstacles


def _balls(hand: Hand) -> PointBalls:
    """Return the balls of all links, but not of an arm's that stand still, of which `check_base` tells.

    A robot takes those of its hand's links from the hand, whose meshes it has.
    """
    points, moved, found = hand.dense_points, hand.moved_links, []
    for link in np.unique(points.link).tolist():
        known, own = _known_balls(hand.link_meshes[link]), points.link == link
        key = next(iter(known), link) if hand.coarse_links else link
        if hand.coarse_links and not moved[link]:
            continue
        if key not in known:
            known[key] = point_balls(LinkPoints(points.points[own], points.normals[own], points.link[own]))
        found.append(replace(known[key], link=np.full_like(known[key].link, link)))
    return joined_balls(found)


@cached_per_instance
def _known_balls(_: trimesh.Trimesh) -> dict[int, PointBalls]:
    """Return the balls of the links with this mesh, by number of the link; empty at first."""
    return {}


@cached_per_instance
def _model(hand: Hand) -> tuple[WarpStruct, PointBalls]:
    """Return the hand as a struct for the kernel, and its balls for Python."""
    balls = _balls(hand)

    def array(values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device="cpu")

    model = ClearanceHand()
    model.tree = kinematic_tree(hand)
    model.point = array(balls.point, wp.vec3)
    model.radius = array(balls.radius, wp.float32)
    model.link = array(balls.link, wp.int32)
    model.following = array(balls.following, wp.int32)
    model.padding = array(np.where([name in hand.coarse_links for name in hand.link_names], PADDING, 0.0), wp.float32)
    return model, balls


class Space(Protocol):
    """States of something that moves, a row of numbers each."""

    def placed(
        self, states: Float[np.ndarray, "n state"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n joint"]]:
        """Return where its root is, world, and its joint angles."""

    def displacement(self, start: Float[np.ndarray, " state"], end: Float[np.ndarray, " state"]) -> float:
        """Return a bound on the way of any of its points on the straight motion between two states [m]."""

    def between(
        self, start: Float[np.ndarray, " state"], end: Float[np.ndarray, " state"], fraction: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n state"]:
        """Return states at fractions of that motion."""


Moving = TypeVar("Moving", bound=Space)


@dataclass(frozen=True)
class MotionCheck(Generic[Moving]):
    """Checks straight motions of a hand, or of a robot, so finely that nothing can slip through.

    A state with clearance c vouches for all states to which no point of the hand moves farther than c; where that does not
    cover the motion, its halves are checked. States next to each other are at most 2 (clearance - 0.5 mm)
    apart, 5 mm, in the motion of the hand's fastest point, whatever the clearance.
    """

    space: Moving
    measure: HandClearance
    clearance: float = CLEARANCE

    def clearances(self, states: Float[np.ndarray, "n state"], *, stop: float = NO_STOP) -> Clearances:
        """Return the least distances to environment and object; see `HandClearance`."""
        return self.measure(*self.space.placed(states), stop=stop)

    def states_free(self, states: Float[np.ndarray, "n state"]) -> Bool[np.ndarray, " n"]:
        """Return which states keep the clearance."""
        return self.clearances(states, stop=self.clearance).distance.min(axis=1) >= self.clearance

    def free(self, start: Float[np.ndarray, " state"], end: Float[np.ndarray, " state"]) -> bool:
        """Return whether the whole straight motion keeps the clearance, both ends included."""
        return self.blocked_at(start, end) is None

    def blocked_at(self, start: Float[np.ndarray, " state"], end: Float[np.ndarray, " state"]) -> float | None:
        """Return a fraction of the motion at which the clearance is not kept; None where the motion is free.

        It is that of the coarsest state that shows the obstacle, not of the first along the way.
        """
        way = self.space.displacement(start, end)
        ends = self.states_free(self.space.between(start, end, np.array([1.0, 0.0])))
        if not ends.all():
            return 0.0 if not ends[1] else 1.0
        slack = self.clearance - ASSURED
        middle, half = np.array([0.5]), 0.5
        while len(middle):
            distance = self.clearances(self.space.between(start, end, middle), stop=self.clearance).distance.min(axis=1)
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
    """Why there is no way, and where: at the "start", in "transit", at "pre-contact", before "contact" or at the "goal".

    obstacle: "environment", "object", or "hand" where the hand's own links are in one another. link: of the hand, the one
    that comes nearest; empty for "hand". point: on the obstacle, nearest to that link [m, world]; NaN for "hand". clearance:
    of that link there [m], negative inside. reason: one sentence.
    """

    stage: str
    obstacle: str
    link: str
    point: Float[np.ndarray, "3"]
    clearance: float
    reason: str


def nearest_obstacle(
    check: MotionCheck[StateSpace], scene: Scene, where: State, *, among: Sequence[str] = OBSTACLES
) -> tuple[str, str, Float[np.ndarray, "3"], float, Float[np.ndarray, "3"]] | None:
    """Return what the hand is nearest to in the state `where`; None where all of `among` is beyond `CAP`.

    Obstacle, link, point and clearance as in `Blocked`, and the unit direction from the obstacle to the hand.
    """
    found = check.clearances(where[None])
    column = min((OBSTACLES.index(name) for name in among), key=lambda index: found.distance[0, index])
    ball = int(found.nearest[0, column])
    if ball < 0:
        return None
    link, place = check.measure.link_and_point(ball, check.space.configurations(where[None])[0])
    mesh = scene.environment_mesh if OBSTACLES[column] == "environment" else scene.object_in_world()
    hit = ExactDistance(mesh)(place[None])
    gap = place - hit.closest[0]
    length = float(np.linalg.norm(gap))
    away = np.sign(hit.distance[0]) * gap / length if length > 0 else hit.normal[0]
    return OBSTACLES[column], link, hit.closest[0], float(found.distance[0, column]), away


def blocked_by_itself(stage: str, depth: float) -> Blocked:
    """Return that the hand's links are `depth` [m] in one another."""
    return Blocked(
        stage, "hand", "", np.full(3, np.nan), -depth, f"the hand's links are {1e3 * depth:.1f} mm in one another"
    )
