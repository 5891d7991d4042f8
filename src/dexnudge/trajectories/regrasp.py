"""A plan that goes on after its push: the robot grasps the object where a rehearsal has left it, lifts it and holds it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.execution.grasp_and_lift import (
    HOLD_TIME,
    LIFT,
    LIFT_SPEED,
    MOST_PLANNED,
    SQUEEZE_SHARE,
    Grasp,
    GraspFinder,
    LiftWay,
)
from dexnudge.execution.scene_rollout import opening_path
from dexnudge.execution.slide_grasp_lift import AIM, GRASP_DRAWS
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.arm_approach import ArmApproach, NoWay
from dexnudge.planning.object_path import DEFAULT_LIMITS, plan_object_motion, push_length
from dexnudge.planning.outcomes import Outcome
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hold import LiftRehearsal, squeeze
from dexnudge.simulation.model import SimulationModel, scene_model
from dexnudge.simulation.rollout import Rollout
from dexnudge.trajectories.interpolation import limits_used
from dexnudge.trajectories.plan import JointTrajectory, Phase, Plan
from dexnudge.trajectories.plan_episode import PlanEpisode, execute_plan
from dexnudge.trajectories.pressing import DEEPEST, GIVING_WAY, deepest
from dexnudge.trajectories.robot_timing import (
    CLOSING_SPEED,
    CLOSING_STATIONS,
    CONTACT_SPEED,
    LOAD_TIME,
    SETTLE_TIME,
    Pace,
    closing,
    rise,
    with_margin,
)
from dexnudge.trajectories.timing import concatenated, hold, time_optimal

LIFT_SPACING = 0.004  # [m] between stations of the lift


@dataclass(frozen=True)
class Lifted:
    """What came of going on: the plan with regrasp and lift, played; or the push alone, and why there is no more.

    outcome: SUCCESS where the object was lifted and held. detail: what it leaves open. attempts: grasps that were played.
    """

    episode: PlanEpisode
    outcome: Outcome
    detail: str = ""
    attempts: int = 0


def graspable_length(scene: Scene) -> float:
    """Return by how much to push the object until enough of it is free to be grasped [m]; else the length of the scene."""
    for limits in (AIM, DEFAULT_LIMITS):
        found = plan_object_motion(scene, limits)
        if not isinstance(found, Outcome) and found.length > 0.0:
            return found.length
    return push_length(scene)


def with_grasp(
    plan: Plan,
    sampler: Sampler,
    *,
    attempts: int = 3,
    speed: float = 1.0,
    seed: int = 0,
) -> Lifted:
    """Return the plan with the phases regrasp and lift, rehearsed: the first of some grasps that lifts the object.

    The push is rehearsed, and grasps are drawn where the object lies then. Every rehearsal begins at the start of the plan.

    Args:
        plan: of a push.
        sampler: of grasps by the robot's hand.
        attempts: grasps that are played at most.
        speed: share of full speed; see `Pace`.
        seed: of the grasps and of the arm's planner.

    Raises:
        MeshError: MuJoCo cannot take the object or the surroundings.
    """
    pushed = execute_plan(plan)
    if not pushed.success:
        return Lifted(pushed, pushed.outcome)
    xml = pushed.model.simulation.xml
    (T_world_object,) = pushed.model.simulation.object_poses(pushed.trace.qpos[-1:])
    scene = replace(plan.scene, T_world_object=T_world_object)
    simulation = replace(scene_model(plan.robot.hand, plan.scene), T_world_object=T_world_object)
    finder = GraspFinder(plan.robot.hand, sampler, plan.scene, LiftRehearsal(simulation, plan.scene))
    grasps, rejected = finder.find(scene, num=GRASP_DRAWS, seed=seed)
    if not grasps:
        reasons = ", ".join(f"{reason} {count}" for reason, count in rejected.most_common())
        return Lifted(pushed, Outcome.NO_GRASP, f"in {GRASP_DRAWS} draws: {reasons}")
    last = Lifted(pushed, Outcome.APPROACH_BLOCKED)
    for found in _lifts(plan, Pace(plan.robot, speed), scene, simulation, grasps, seed=seed):
        if isinstance(found, str):
            last = last if last.attempts else replace(last, detail=found)
            continue
        episode = execute_plan(found, xml=xml)
        last = Lifted(episode, episode.outcome, attempts=last.attempts + 1)
        if episode.success or last.attempts == attempts:
            break
    return last


def _lifts(
    plan: Plan, pace: Pace, scene: Scene, simulation: SimulationModel, grasps: list[Grasp], *, seed: int
) -> Iterator[Plan | str]:
    """Yield the plan that goes on with each grasp, best first, or why it cannot."""
    robot = plan.robot
    approach = ArmApproach(with_margin(robot), scene, contact="regrasp", before="regrasp", seed=seed)
    up = LiftWay(robot.hand, scene, height=LIFT)
    for grasp in grasps[:MOST_PLANNED]:
        q = np.asarray(transform_configurations(scene.T_world_object, grasp.q[None])[0])
        ways = up(q)
        if ways is None:
            yield "no free way up or out"
            continue
        way = approach.to(q, start=plan.trajectory.position[-1, : robot.arm.num_joints])
        if isinstance(way, NoWay):
            yield way.reason
            continue
        transit, entry = way
        fingers = _by_the_open_hand(robot, plan.trajectory.position[-1], transit[0])
        if fingers is None:
            yield "the fingers get into each other on their way from the push to the grasp"
            continue
        opening = time_optimal(fingers, pace.limits, corner=0.0)
        if approach.clearance.of(opening.position, stop=0.0).min() < 0.0:
            yield "the hand cannot open its fingers at home"
            continue
        gripping, effort = _closed(simulation, scene, grasp, q)
        tries = (q + share * (gripping - q) for share in GIVING_WAY)
        closed = next(
            (one for one in tries if deepest(robot.hand, scene, one[None], np.zeros((1, 3))) <= DEEPEST), None
        )
        if closed is None:
            yield f"the hand that grips gets more than {1e3 * DEEPEST:g} mm into something"
            continue
        raised = _carried(closed, ways)
        stations = np.concatenate([closing(q, closed), raised[1:]])
        positions, reached = approach.followed(stations[None], entry.stretch[:1, : robot.arm.num_joints])
        if reached[0] < positions.shape[1]:
            yield "the arm cannot follow the hand as it lifts"
            continue
        gripped, lifting = positions[0, :CLOSING_STATIONS], positions[0, CLOSING_STATIONS - 1 :]
        blocked = approach.what_blocks(lifting)
        if blocked:
            yield blocked
            continue
        gripped[0] = entry.stretch[0]
        yield _continued(
            plan,
            pace,
            scene,
            [
                opening,
                pace.through(transit, approach.clearance),
                pace.along(entry.exit[::-1]),
                pace.along(entry.stretch[::-1], speed=CONTACT_SPEED),
                pace.along(gripped, speed=CLOSING_SPEED),
            ],
            lifting,
            effort,
        )


def _closed(
    simulation: SimulationModel, scene: Scene, grasp: Grasp, q: Float[np.ndarray, " coordinates"]
) -> tuple[Float[np.ndarray, " coordinates"], Float[np.ndarray, " d"]]:
    """Return q and the fingers' efforts [N m] once they have closed on the object, rehearsed on a compliant arm."""
    contacts = grasp.contacts.moved(scene.T_world_object)
    simulation.place(q)
    friction = SQUEEZE_SHARE * scene.friction_hand
    _, torque = squeeze(simulation, contacts, half_length=sliding_task(scene).half_length, friction=friction)
    rollout = Rollout(simulation, q, recorded=False)
    rollout.close(torque, "close")
    closed = q.copy()
    closed[ROOT_COORDINATES:] = rollout.q[ROOT_COORDINATES:]
    motors = np.setdiff1d(np.arange(simulation.model.nu), simulation.base_motor)
    force = simulation.data.actuator_force[motors]
    return closed, np.asarray(force @ (simulation.motor_of_angle[motors] > 0))


def _by_the_open_hand(
    robot: Robot, start: Float[np.ndarray, " joint"], end: Float[np.ndarray, " joint"]
) -> Float[np.ndarray, "vertex joint"] | None:
    """Return positions between two postures of the fingers by way of the open hand, clean ones; None if there are none."""
    arm = robot.arm.num_joints
    opens, closes = (opening_path(robot.hand, posture[arm:]) for posture in (start, end))
    if opens is None or closes is None:
        return None
    rows = [start[arm:], *opens, *closes[-2::-1], end[arm:]]
    return np.array([np.concatenate([start[:arm], row]) for row in rows])


def _carried(
    q: Float[np.ndarray, " coordinates"], ways: list[Float[np.ndarray, " 3"]]
) -> Float[np.ndarray, "station coordinates"]:
    """Return q along translations [m, world] one after another."""
    rows = q[None]
    for way in ways:
        count = int(np.ceil(np.linalg.norm(way) / LIFT_SPACING))
        carried = np.repeat(rows[-1:], count, axis=0)
        carried[:, :3] += (np.arange(1, count + 1) / count)[:, None] * way
        rows = np.concatenate([rows, carried])
    return rows


def _continued(
    plan: Plan,
    pace: Pace,
    scene: Scene,
    coming: list[JointTrajectory],
    lifting: Float[np.ndarray, "station joint"],
    effort: Float[np.ndarray, " d"],
) -> Plan | str:
    """Return the plan that comes to the object, takes it, lifts it and holds it."""
    robot = plan.robot
    whole = np.concatenate([np.zeros(robot.arm.num_joints), effort])
    load, raised = hold(lifting[0], LOAD_TIME), pace.along(lifting, speed=LIFT_SPEED)
    held = [
        replace(part, effort=np.tile(whole, (len(part.time), 1)))
        for part in (hold(lifting[0], SETTLE_TIME), raised, hold(lifting[-1], HOLD_TIME))
    ]
    regrasp = concatenated(*coming, replace(load, effort=rise(load)[:, None] * whole), held[0])
    lift = concatenated(*held[1:])
    trajectory = concatenated(plan.trajectory, regrasp, lift)
    exceeded = limits_used(trajectory, robot.limits, robot.joint_names).exceeded
    if exceeded:
        return str(exceeded[0])
    start = plan.phases[-1].end
    middle, end = (round(start + seconds, 6) for seconds in (regrasp.duration, regrasp.duration + lift.duration))
    above = scene.T_world_object.copy()
    above[2, 3] += LIFT
    number = plan.phases[0].configuration
    phases = (
        *plan.phases,
        Phase("regrasp", start, middle, number, scene.T_world_object),
        Phase("lift", middle, end, number, above),
    )
    return replace(plan, trajectory=trajectory, phases=phases)
