"""How deep arm and hand get into the object, the surroundings and themselves while they follow a plan.

By exact distances (`verification.penetration`), which no planner goes by. Depths are looked at where the trajectory's
quintics are at every millisecond; a millisecond is left out where no point has come 0.2 mm from where it was measured last,
so that no depth in object or surroundings is more than that above what is found.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation, Slerp

from dexnudge.hands.hand import Hand
from dexnudge.trajectories.interpolation import at
from dexnudge.trajectories.plan import Plan
from dexnudge.verification.penetration import PenetrationCheck

INTERVAL = 0.001  # [s] controllers of arms run at 1 kHz
STEP = 0.0002  # [m] a fifth of what a plan may penetrate
SELF_INTERVAL = 0.01  # [s] between states at which the robot is looked for in itself: links turn slowly
MOVING = ("push", "lift")  # phases in which the object goes along with the hand
BATCH = 256  # states that are measured at once


@dataclass(frozen=True)
class PlanPenetrations:
    """Depths [m] along a plan, 0 where nothing penetrates.

    time: [s] of object and environment; of the object where it is at that time. self_collision: 10 ms apart.
    """

    time: Float[np.ndarray, " t"]
    object: Float[np.ndarray, " t"]
    environment: Float[np.ndarray, " t"]
    self_collision: Float[np.ndarray, " s"]

    @property
    def greatest(self) -> dict[str, float]:
        """The greatest depth in each [m]."""
        return {name: float(getattr(self, name).max()) for name in ("object", "environment", "self_collision")}


def plan_penetrations(plan: Plan) -> PlanPenetrations:
    """Return how deep a plan's robot is in object, surroundings and itself, from its first sample to its last."""
    robot, knots = plan.robot, plan.trajectory.time
    time = np.append(np.arange(knots[0], knots[-1], INTERVAL), knots[-1])
    positions = at(plan.trajectory, time).position
    T_world_link = robot.link_poses(positions)
    T_world_object = object_poses(plan, time, robot.palm_poses(positions))
    check = PenetrationCheck(robot.body, plan.scene)
    carried = np.linalg.norm(np.diff(T_world_object[:, :3, 3], axis=0), axis=1)
    chosen = _stations(np.cumsum(np.append(0.0, _ways(robot.body, T_world_link) + carried)))
    apart = chosen[_stations(time[chosen] - time[0], SELF_INTERVAL)]
    # As if the robot moved, and the object did not.
    T_object = plan.scene.T_world_object @ np.linalg.inv(T_world_object)

    def measured(rows: Int[np.ndarray, " n"], depths: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        return np.concatenate([depths(part) for part in np.array_split(rows, -(-len(rows) // BATCH))])

    return PlanPenetrations(
        time=time[chosen],
        object=measured(chosen, lambda rows: check.in_object(T_object[rows, None] @ T_world_link[rows])[0]),
        environment=measured(chosen, lambda rows: check.in_environment(T_world_link[rows])),
        self_collision=measured(apart, lambda rows: check.in_itself(T_world_link[rows])),
    )


def object_poses(
    plan: Plan, time: Float[np.ndarray, " t"], T_world_palm: Float[np.ndarray, "t 4 4"]
) -> Float[np.ndarray, "t 4 4"]:
    """Return T_world_object at times [s]: at rest, or, while it is pushed or lifted, as far on its way as the palm is."""
    poses = np.tile(plan.scene.T_world_object, (len(time), 1, 1))
    before = plan.scene.T_world_object
    for phase in plan.phases:
        rows = np.flatnonzero(time >= phase.start)
        way = phase.T_world_object[:3, 3] - before[:3, 3]
        share = np.ones(len(rows))
        if phase.name in MOVING and len(rows) and way @ way > 0:
            share = (T_world_palm[rows, :3, 3] - T_world_palm[rows[0], :3, 3]) @ way / (way @ way)
            share = np.where(time[rows] > phase.end, 1.0, share.clip(0.0, 1.0))
        ends = Rotation.from_matrix(np.stack([before[:3, :3], phase.T_world_object[:3, :3]]))
        poses[rows, :3, :3] = Slerp([0.0, 1.0], ends)(share).as_matrix()
        poses[rows, :3, 3] = before[:3, 3] + share[:, None] * way
        before = phase.T_world_object
    return poses


def _ways(body: Hand, T_world_link: Float[np.ndarray, "t link 4 4"]) -> Float[np.ndarray, " _"]:
    """Return how far any point of the body comes from each state to the next [m]: no farther than its boxes' corners."""
    ways = np.zeros(len(T_world_link) - 1)
    for link, mesh in enumerate(body.link_meshes):
        if len(mesh.faces):
            corners = mesh.bounding_box.vertices
            places = (
                np.einsum("tij,cj->tci", T_world_link[:, link, :3, :3], corners) + T_world_link[:, link, None, :3, 3]
            )
            np.maximum(ways, np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1), out=ways)
    return ways


def _stations(travelled: Float[np.ndarray, " t"], step: float = STEP) -> Int[np.ndarray, " _"]:
    """Return the first state, and each one that is the first to enter another stretch of length `step`."""
    return np.flatnonzero(np.diff(np.floor(travelled / step), prepend=-1.0))
