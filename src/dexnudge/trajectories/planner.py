"""Plans: verified configurations become one trajectory of arm and hand."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import Arm
from dexnudge.arms.mounting import mount as mounted
from dexnudge.arms.robot import Robot
from dexnudge.arms.standing import check_base, with_floor
from dexnudge.errors import InputError, PlanningError, check_integer, check_kind
from dexnudge.geometry.devices import own_modes
from dexnudge.planning.arm_approach import NoWay
from dexnudge.planning.object_path import check_slides, push_length
from dexnudge.planning.outcomes import Outcome
from dexnudge.planning.push_way import PushWay, PushWayPlanner
from dexnudge.results.samples import Sample, Samples
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import SPEED
from dexnudge.simulation.model import SimulationModel, scene_model
from dexnudge.trajectories.interpolation import limits_used
from dexnudge.trajectories.plan import JointTrajectory, Phase, Plan
from dexnudge.trajectories.plan_episode import execute_plan
from dexnudge.trajectories.pressing import DEEPEST, GIVING_WAY, Press, deepest, press
from dexnudge.trajectories.regrasp import graspable_length, with_grasp
from dexnudge.trajectories.robot_timing import (
    CLOSING_SPEED,
    CONTACT_SPEED,
    LOAD_TIME,
    RELEASE_TIME,
    SETTLE_TIME,
    Pace,
    closing,
    rise,
    with_margin,
)
from dexnudge.trajectories.timing import concatenated, hold

TOP = 8  # configurations that are tried, best first
PUSH_SPACING = 0.002  # [m] between stations of the push
SAME_POSITION = 1e-3  # [rad] by which inverse kinematics may leave the position that it starts from


@dataclass(frozen=True)
class Failure:
    """Why a configuration has no plan: its place among the samples, the phase that failed, and the reason in words."""

    configuration: int
    phase: str
    reason: str


@own_modes()
def plan(
    samples: Samples | Sample,
    arm: Arm,
    *,
    mount: Any = None,
    floor: float | None = None,
    top: int = TOP,
    seed: int = 0,
    then_grasp: bool = False,
    speed: float = 1.0,
    weights: Path | str | None = None,
    on_failure: Callable[[Failure], None] = lambda _: None,
) -> Plan:
    """Return a trajectory of arm and hand for the best verified configuration that has one.

    Home, pre-contact, contact, squeeze, push, retreat: free of collisions, as fast as the limits of velocity, acceleration
    and jerk allow, straight and slow while the object is touched. Rehearsed in MuJoCo before it is returned.

    Args:
        samples: of one scene, best first; or a single one.
        arm: where it stands, such as `load_arm("panda", base=T_world_base)`.
        mount: (4, 4) T_flange_mount; the default of arm and hand unless given.
        floor: what the arm stands on, height of its top [m, world z]: a slab of 3 x 3 m that joins the scene's surroundings.
            Without it the arm knows nothing of what it stands on, and may sweep below its base. An object that is pushed
            over an edge needs the room below it.
        top: configurations that are tried at most.
        seed: of the planner, and of the grasps.
        then_grasp: push the object to where it can be grasped, grasp it, lift it by 10 cm and hold it for 2 s. Where it
            lies after the push, and whether the grasp holds, comes from a rehearsal in MuJoCo, which takes half a minute.
        speed: share of the joints' velocities that is used, above 0, at most 1: small for a first run on a robot.
        weights: with `then_grasp`, folder of the model that draws grasps; None for the one that ships for this hand.
        on_failure: called with every configuration that has no plan.

    Raises:
        InputError: something else than samples, none of which is verified, a number out of range, or a motion that turns.
        ArmError: an arm that cannot stand there, a mount that cannot be, an object out of its reach, or a floor above base
            or object.
        PlanningError: no configuration has a plan; `failures` says why.
        MeshError: MuJoCo cannot take the object or the surroundings.
        CheckpointError: with `then_grasp`, no weights for this hand, or weights that are broken or made for another.
    """
    check_integer("top", top, least=1)
    check_integer("seed", seed, least=0)
    if not 0 < speed <= 1:
        raise InputError(f"`speed` is {speed}; expected a share above 0, at most 1")
    chosen = [samples] if isinstance(samples, Sample) else samples
    if isinstance(chosen, Samples):
        chosen = list(chosen.verified[:top])
    else:
        check_kind("samples", samples, Samples, "Sampler(hand).sample(scene)")
    if not chosen:
        raise PlanningError("none of the samples is verified, so there is nothing to plan; draw more (`num`)", ())
    hand, scene = chosen[0].hand, chosen[0].scene
    scene = scene if floor is None else with_floor(scene, arm, floor)
    sampler = Sampler.from_pretrained(hand, weights=weights) if then_grasp else None
    length = graspable_length(scene) if then_grasp else None
    planner = Planner(scene, mounted(arm, hand, mount), length=length, speed=speed, seed=seed)
    found, failures = first_plan(planner, chosen, sampler, speed=speed, seed=seed, on_failure=on_failure)
    if found is not None:
        return found
    raise PlanningError(
        f"none of {len(failures)} configurations has a plan for {planner.robot!r}: "
        + "; ".join(f"{one.configuration}: {one.phase}: {one.reason}" for one in failures)
        + "; move the base, turn the mount, or draw more (`arm_base`, `mount`, `num`)",
        tuple(failures),
    )


def first_plan(
    planner: "Planner",
    samples: Iterable[Sample],
    sampler: Sampler | None,
    *,
    speed: float = 1.0,
    seed: int,
    on_failure: Callable[[Failure], None] = lambda _: None,
) -> tuple[Plan | None, list[Failure]]:
    """Return the first plan that succeeds in a rehearsal, with `sampler` up to a lift, and why samples before have none."""
    failures: list[Failure] = []
    for place, sample in enumerate(samples):
        found = planner(sample.q, configuration=place)
        if isinstance(found, Plan):
            found = _rehearsed(found) if sampler is None else _lifting(found, sampler, speed=speed, seed=seed)
        if isinstance(found, Plan):
            return found, failures
        failures.append(found)
        on_failure(found)
    return None, failures


def _rehearsed(plan: Plan) -> Plan | Failure:
    """Return the plan if the object is pushed when it is played, else what happened."""
    clock = time.perf_counter()
    played = execute_plan(plan)
    if not played.success:
        return Failure(played.configuration, "push", f"in a rehearsal, {played.outcome.sentence}")
    return replace(plan, seconds={**plan.seconds, "rehearsal": round(time.perf_counter() - clock, 4)})


def _lifting(pushing: Plan, sampler: Sampler, *, speed: float, seed: int) -> Plan | Failure:
    """Return the plan that goes on with a grasp and a lift, or why there is none."""
    lifted = with_grasp(pushing, sampler, speed=speed, seed=seed)
    if lifted.outcome is Outcome.SUCCESS:
        return lifted.episode.plan
    phase = "lift" if lifted.attempts else "regrasp" if lifted.episode.success else "push"
    return Failure(pushing.phases[0].configuration, phase, f"{lifted.outcome.sentence} {lifted.detail}".strip())


class Planner:
    """Plans for one robot in one scene; make it once for many configurations.

    length: of the push [m]; None: that of the scene. speed: share of full speed.
    """

    def __init__(
        self, scene: Scene, robot: Robot, *, length: float | None = None, speed: float = 1.0, seed: int = 0
    ) -> None:
        check_slides(scene, "a plan for an arm")
        check_base(robot, scene)
        self.scene, self.robot = scene, robot
        length = push_length(scene) if length is None else length
        self._way = PushWayPlanner(with_margin(robot), scene, length=length, seed=seed)
        self._pace = Pace(robot, speed)
        self._simulation: SimulationModel | None = None

    def __call__(self, q: Float[np.ndarray, " coordinates"], *, configuration: int = 0) -> Plan | Failure:
        """Return the plan of one configuration (world), or why it has none."""
        way = self._way.plan(q)
        if isinstance(way, NoWay):
            return Failure(configuration, way.phase, way.reason)
        clock = time.perf_counter()
        if self._simulation is None:
            self._simulation = scene_model(self.robot.hand, self.scene)
        pressed = press(self._simulation, self.scene, q, length=self._way.length)
        seconds = {**self._way.seconds, "forces": time.perf_counter() - clock}
        if not pressed.verdict.success:
            return Failure(configuration, "push", f"in a rehearsal, {pressed.verdict.outcome.sentence}")
        cleaned = (pressed.nearer_contact(share) for share in GIVING_WAY)
        clean = next((one for one in cleaned if one.depth(self.robot.hand, self.scene) <= DEEPEST), None)
        if clean is None:
            return Failure(
                configuration, "push", f"the hand that presses gets more than {1e3 * DEEPEST:g} mm into something"
            )
        seconds["forces"] = time.perf_counter() - clock
        clock = time.perf_counter()
        found = self._timed(way, clean, configuration)
        if isinstance(found, Failure):
            return found
        seconds["timing"] = time.perf_counter() - clock
        return replace(found, seconds={stage: round(value, 4) for stage, value in seconds.items()})

    def _timed(self, way: PushWay, pressed: Press, configuration: int) -> Plan | Failure:
        robot, pace = self.robot, self._pace
        closed = self._followed(closing(pressed.contact, pressed.touching), way.push[0])
        push = None if closed is None else self._pushed(closed[-1], pressed)
        if closed is None or push is None:
            return Failure(configuration, "squeeze", "the arm cannot follow the hand as it closes")
        parts = {
            "pre-contact": [
                pace.through(way.transit, self._way.before.clearance),
                pace.along(way.entry.exit[::-1]),
            ],
            "contact": [pace.along(way.entry.stretch[::-1], speed=CONTACT_SPEED)],
            "squeeze": [
                pace.along(closed, speed=CLOSING_SPEED),
                self._loaded(closed[-1], pressed, LOAD_TIME, 0.0, 1.0),
                self._loaded(closed[-1], pressed, SETTLE_TIME, 1.0, 1.0),
            ],
            "push": [self._carried(push, pressed)],
            "retreat": [
                self._loaded(push[-1], pressed, RELEASE_TIME, 1.0, 0.0),
                *self._leaving(push[-1], way.leave.stretch, pressed),
                pace.along(way.leave.exit),
                pace.through(way.home, self._way.after.clearance),
            ],
        }
        pieces = {name: concatenated(*some) for name, some in parts.items()}
        trajectory = concatenated(*pieces.values())
        exceeded = limits_used(trajectory, robot.limits, robot.joint_names).exceeded
        if exceeded:
            return Failure(configuration, "timing", str(exceeded[0]))
        phases, start = [], 0.0
        for name, piece in pieces.items():
            end = round(start + piece.duration, 6)
            moved = name in ("push", "retreat")
            T_world_object = (self._way.moved if moved else self.scene).T_world_object
            force = dict(pressed.link_force) if name in ("squeeze", "push") else {}
            phases.append(Phase(name, start, end, configuration, T_world_object, force))
            start = end
        return Plan(robot, self.scene, trajectory, tuple(phases), pressed.length)

    def _leaving(
        self, pressing: Float[np.ndarray, " joint"], stretch: Float[np.ndarray, "station joint"], pressed: Press
    ) -> list[JointTrajectory]:
        """Return the way from where the hand presses to the end of `stretch`, which begins at contact.

        The hand opens as it leaves. If it went to contact first, it would press on an object that is not quite where it was
        planned, by 20 N for a millimetre; it does where the straight way gets into something.
        """
        left = np.linspace(1.0, 0.0, len(stretch))[:, None]
        straight = stretch + left * (pressing - stretch[0])
        carried = np.tile(pressed.length * pressed.motion, (len(straight), 1))
        if deepest(self.robot.hand, self.scene, self.robot.configurations(straight), carried) <= DEEPEST:
            return [self._pace.along(straight, speed=CONTACT_SPEED)]
        opening = closing(pressing, stretch[0])
        return [
            self._pace.along(opening, speed=CLOSING_SPEED),
            self._pace.along(stretch, speed=CONTACT_SPEED),
        ]

    def _pushed(
        self, touching: Float[np.ndarray, " joint"], pressed: Press
    ) -> Float[np.ndarray, "station joint"] | None:
        count = int(np.ceil(pressed.length / PUSH_SPACING)) + 1
        return self._followed(pressed.carried(np.linspace(0.0, pressed.length, count)), touching)

    def _followed(
        self, q: Float[np.ndarray, "station coordinates"], start: Float[np.ndarray, " joint"]
    ) -> Float[np.ndarray, "station joint"] | None:
        positions, reached = self._way.before.followed(q[None], start[None, : self.robot.arm.num_joints])
        if reached[0] < len(q):
            return None
        if np.abs(positions[0, 0] - start).max() < SAME_POSITION:
            positions[0, 0] = start
        return np.asarray(positions[0])

    def _loaded(
        self, position: Float[np.ndarray, " joint"], pressed: Press, seconds: float, first: float, last: float
    ) -> JointTrajectory:
        """Return a stay during which the share of the forces goes smoothly from `first` to `last`."""
        still = hold(position, seconds)
        loaded = first + (last - first) * rise(still)
        return replace(still, effort=pressed.efforts(self.robot, still.position, loaded))

    def _carried(self, path: Float[np.ndarray, "station joint"], pressed: Press) -> JointTrajectory:
        progress = np.linspace(0.0, pressed.length, len(path))
        carried = self._pace.passed(path, progress, speed=SPEED)
        effort = pressed.efforts(self.robot, carried.position, np.ones(len(carried.time)))
        return replace(carried, effort=effort)
