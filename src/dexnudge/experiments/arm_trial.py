"""Arms: draws that an arm reaches become a plan, which is measured, and played by the motors of arm and hand."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from dexnudge.arms.mounting import mount as mounted
from dexnudge.arms.registry import load_arm
from dexnudge.arms.robot import Robot
from dexnudge.arms.standing import DISTANCE, check_base, default_base
from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_seed
from dexnudge.experiments.metrics import FAILED, OBJECTS, UNVERIFIED, Metric, share
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.scan_trial import NUMBER
from dexnudge.experiments.statistics import mean_of_known, quantile_estimate
from dexnudge.experiments.tables import Table
from dexnudge.experiments.trial import Section, TrialKind, TrialSampler
from dexnudge.planning.outcomes import Outcome
from dexnudge.planning.reach import Reach
from dexnudge.results.samples import Samples
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.trajectories.interpolation import limits_used
from dexnudge.trajectories.plan import Plan
from dexnudge.trajectories.plan_episode import execute_plan
from dexnudge.trajectories.plan_penetration import plan_penetrations
from dexnudge.trajectories.planner import TOP, Failure, Planner, first_plan
from dexnudge.trajectories.regrasp import graspable_length

LIMITS = ("position", "velocity", "acceleration", "jerk")


@dataclass(frozen=True, kw_only=True)
class ArmRecord(TrialRecord):
    """What an arm makes of the draws for an object in a scene.

    `verified` counts the draws that the arm reaches, too. Figures are None, or empty, where there is no plan.

    Attributes:
        base_distance: of the arm's base from the object, level [m].
        configuration: rank of the one that is planned, 0 the best. q: of it, world.
        failures: of the configurations before it, or of all that were tried.
        duration: of the trajectory [s]. phases: of each of them [s].
        limits: largest share of each limit that any joint uses.
        penetration_mm: greatest depth of arm and hand in object, environment and self, by `plan_penetrations`.
        outcome: value of the `Outcome` of playing the plan; "" where it was not. length_asked, length_reached [m],
            turned_deg: of that push. delay: of the joints behind the plan [s]. palm_error_mm, arm_error, hand_error:
            greatest tracking error of the palm, of the arm's joints and of the hand's [rad]. lift: value of the `Outcome` of
            the lift; "" where none was played.
    """

    kind: ClassVar[str] = "arm"

    base_distance: float | None = None
    configuration: int | None = None
    q: list[float] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    duration: float | None = None
    phases: dict[str, float] = field(default_factory=dict)
    limits: dict[str, float] = field(default_factory=dict)
    penetration_mm: dict[str, float] = field(default_factory=dict)
    outcome: str = ""
    length_asked: float | None = None
    length_reached: float | None = None
    turned_deg: float | None = None
    delay: float | None = None
    palm_error_mm: float | None = None
    arm_error: float | None = None
    lift: str = ""
    hand_error: float | None = None

    @property
    def planned(self) -> bool:
        """Whether one of the configurations has a plan."""
        return self.configuration is not None

    @property
    def executed(self) -> bool:
        """Whether the plan pushes the object to where it should be."""
        return self.outcome == Outcome.SUCCESS.value

    @property
    def succeeded(self) -> bool:
        """Whether there is a plan, and where it was played, whether it succeeds."""
        return self.planned and {self.outcome, self.lift} <= {"", Outcome.SUCCESS.value}

    @property
    def lifted(self) -> bool:
        """Whether the object was lifted and held."""
        return self.lift == Outcome.SUCCESS.value


Records = Sequence[ArmRecord]


def _spent(part: float) -> Callable[[Records], Any]:
    """Return the metric that is a quantile of the seconds of planning, with or without a plan."""
    return lambda records: quantile_estimate([each.seconds["plan"] for each in records if "plan" in each.seconds], part)


def _largest(field: str, name: str) -> Callable[[Records], float | None]:
    return lambda records: max((getattr(each, field)[name] for each in records if each.planned), default=None)


def _greatest(name: str) -> Callable[[Records], float | None]:
    return lambda records: max((value for each in records if (value := getattr(each, name)) is not None), default=None)


def _advance(record: ArmRecord) -> float | None:
    """Share of the length asked for by which the object moved."""
    return record.length_reached / record.length_asked if record.length_reached and record.length_asked else None


def _endings(records: Records) -> dict[str, int]:
    """Scenes without success by why, most frequent first: the phase that most of their configurations fail in."""
    found: Counter[str] = Counter()
    for each in records:
        if each.status != "done":
            found["no draw verified and reached" if each.status == "unverified" else "object failed"] += 1
        elif not each.planned:
            found[f"no plan: {Counter(one.phase for one in each.failures).most_common(1)[0][0]}"] += 1
        elif not each.succeeded:
            ended = each.outcome if not each.executed else f"lift, {each.lift}"
            found[f"played: {ended.replace('_', ' ')}"] += 1
    return dict(found.most_common())


Pose = tuple[tuple[float, ...], ...]
"""(4, 4), as an experiment is told by it."""


@dataclass(frozen=True)
class ArmTrial(TrialKind[ArmRecord]):
    """Plan for an arm, and play the plan.

    arm: name or file. base: T_world_base; None for `default_base`. base_distance: from how far [m] to how far that is from
    the object, drawn evenly for each object and scene; it is more where the base would touch the surroundings. mount:
    T_flange_mount; None for the default. packages: ROS packages that the description names, and their folders. top:
    configurations that are tried. execute: whether the plan is played. then_grasp: whether the plan goes on with a grasp and
    a lift; its seconds then include the rehearsals of these.
    """

    title: ClassVar[str] = "Planned for an arm"
    about: ClassVar[str] = (
        f"Planned: % of all attempted objects for which one of the {TOP} best draws that the arm reaches has a plan. "
        "Seconds of planning, from draws to plan or to none: half of the objects, and nine of ten, take no longer. "
        "Limits: the largest share that any joint uses of its limit at any millisecond. Depth: the greatest of arm and "
        "hand in object, surroundings and themselves along the plans, exact, at every millisecond at which any point has "
        "moved by 0.2 mm, in themselves every 10 ms. Executed: played in MuJoCo by the motors of arm and hand alone. "
        "Tracking: greatest distance of the palm from the plan. In brackets, 95 % intervals by bootstrap over objects."
    )
    folder: ClassVar[str] = "arm"
    record: ClassVar[type[ArmRecord]] = ArmRecord
    needs_verified: ClassVar[bool] = False  # the experiment's own draws need not be reached
    metrics: ClassVar[Sequence[Metric]] = (
        OBJECTS,
        FAILED,
        UNVERIFIED,
        Metric("planned", share(lambda each: each.planned), "planned"),
        Metric("plan_median", _spent(0.5), "median, s", 1),
        Metric("plan_most", _spent(0.9), "90 %, s", 1),
        *(Metric(f"{name}_limit", _largest("limits", name), f"{name} limit", 2) for name in LIMITS),
        Metric("in_object_mm", _largest("penetration_mm", "object"), "depth in object, mm", 2),
        Metric("in_environment_mm", _largest("penetration_mm", "environment"), "in surroundings, mm", 2),
        Metric("in_itself_mm", _largest("penetration_mm", "self_collision"), "in itself, mm", 2),
        Metric(
            "executed",
            lambda records: (
                share(lambda each: each.executed)(records) if any(each.outcome for each in records) else None
            ),
            "executed, of attempted",
        ),
        Metric(
            "executed_of_planned",
            lambda records: mean_of_known(float(each.executed) for each in records if each.outcome),
            "of planned",
        ),
        Metric(
            "lifted",
            lambda records: share(lambda each: each.lifted)(records) if any(each.lift for each in records) else None,
            "lifted, of attempted",
        ),
        Metric("advance", lambda records: mean_of_known(map(_advance, records)), "advance"),
        Metric("palm_error_mm", _greatest("palm_error_mm"), "tracking, mm", 1),
        Metric("outcomes", _endings, "Why objects were not planned or not pushed", "counts"),
    )
    rate: ClassVar[str] = "planned"

    arm: str
    base: Pose | None = None
    base_distance: tuple[float, float] = (DISTANCE, DISTANCE)
    mount: Pose | None = None
    packages: tuple[tuple[str, str], ...] = ()
    top: int = TOP
    execute: bool = False
    then_grasp: bool = False

    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], ArmRecord]:
        """Load sampler and arm; return what draws for a trial, plans, and plays."""
        sampler, arm = TrialSampler(config), load_arm(self.arm, packages=dict(self.packages))
        grasps = Sampler.from_pretrained(sampler.hand, weights=config.weights) if self.then_grasp else None

        def run(key: TrialKey) -> ArmRecord:
            seed = trial_seed(config.seed, key)
            robots: list[Robot] = []

            def reach(scene: Scene) -> list[Reach]:
                distance = float(np.random.default_rng(seed).uniform(*self.base_distance))
                place = default_base(arm, scene, distance=distance) if self.base is None else np.array(self.base)
                pose = None if self.mount is None else np.array(self.mount)
                robots.append(mounted(arm.standing_at(place), sampler.hand, pose))
                check_base(robots[0], scene)
                return [Reach(robots[0].arm, mount=robots[0].T_flange_mount)]

            clock = time.perf_counter()
            samples = sampler.draw(key, reach)
            drawn = time.perf_counter() - clock
            middle = samples.scene.object_in_world().bounds.mean(axis=0)
            away = robots[0].arm.T_world_base[:2, 3] - middle[:2]
            found = self._planned(samples, robots[0], seed, grasps) if samples.num_verified else {"seconds": {}}
            return self.record(
                **key._asdict(),
                **{
                    **found,
                    "status": "done" if samples.num_verified else "unverified",
                    "seed": seed,
                    "num": len(samples),
                    "verified": samples.num_verified,
                    "base_distance": round(float(np.linalg.norm(away)), 4),
                    "seconds": {stage: round(value, 4) for stage, value in {"draw": drawn, **found["seconds"]}.items()},
                },
            )

        return run

    def sections(self, records: Records) -> list[Section]:
        """Return why configurations have no plan, numbers left out, and how long phases take."""
        why: Counter[tuple[str, str, str]] = Counter()
        where: Counter[tuple[str, str, str]] = Counter()
        for each in records:
            reasons = [(each.scene, one.phase, NUMBER.sub("#", one.reason).replace("|", "/")) for one in each.failures]
            why.update(reasons)
            where.update(set(reasons))
        rows = [[*reason, count, where[reason]] for reason, count in why.most_common()]
        refused = Table(["scene", "phase", "reason", "configurations", "objects"], rows, labels=3)
        lasting = [
            [
                scene,
                *(f"{np.median([each.phases[name] for each in group if name in each.phases]):.2f}" for name in names),
            ]
            for scene in dict.fromkeys(each.scene for each in records)
            if (group := [each for each in records if each.scene == scene and each.planned])
            and (names := list(dict.fromkeys(name for each in group for name in each.phases)))
        ]
        names = list(dict.fromkeys(name for each in records for name in each.phases))
        return [
            Section("Why configurations have no plan", "", refused),
            Section("Seconds of each phase", "Median over the plans.", Table(["scene", *names], lasting, labels=1)),
        ]

    def _planned(self, samples: Samples, robot: Robot, seed: int, grasps: Sampler | None) -> dict[str, Any]:
        """Return fields of a record: the plan of the best configuration that has one, and the failures before it."""
        clock = time.perf_counter()
        length = None if grasps is None else graspable_length(samples.scene)
        planner = Planner(samples.scene, robot, length=length, seed=seed)
        found, failures = first_plan(planner, samples.verified[: self.top], grasps, seed=seed)
        seconds = {"plan": time.perf_counter() - clock}
        if found is None:
            return {"failures": failures, "seconds": seconds}
        seconds |= {f"plan: {stage}": value for stage, value in found.seconds.items()}
        rank = len(failures)
        q = [round(float(value), 7) for value in samples.verified[rank].q]
        fields = {"configuration": rank, "q": q, **_measured(found)}
        seconds["measure"] = time.perf_counter() - clock - seconds["plan"]
        if self.execute:
            clock = time.perf_counter()
            fields |= _executed(found)
            seconds["execute"] = time.perf_counter() - clock
        return {**fields, "failures": failures, "seconds": seconds}


def _measured(plan: Plan) -> dict[str, Any]:
    """Return duration, use of limits and depths of a plan by their names in `ArmRecord`."""
    used, deepest = limits_used(plan.trajectory, plan.robot.limits), plan_penetrations(plan).greatest
    return {
        "duration": round(plan.trajectory.duration, 4),
        "phases": {phase.name: round(phase.end - phase.start, 4) for phase in plan.phases},
        "limits": {name: round(float(getattr(used, name).max()), 6) for name in LIMITS},
        "penetration_mm": {name: round(1e3 * depth, 4) for name, depth in deepest.items()},
    }


def _executed(plan: Plan) -> dict[str, Any]:
    """Play a plan, and return how it ended by the names in `ArmRecord`."""
    episode = execute_plan(plan)
    off, arm = np.abs(episode.trace.tracking_error), plan.robot.arm.num_joints
    return {
        "outcome": episode.verdict.outcome.value,
        "lift": "" if episode.lift is None else episode.lift.outcome.value,
        "length_asked": round(episode.length_asked, 5),
        "length_reached": round(episode.length_reached, 5),
        "turned_deg": round(episode.verdict.turned_deg, 3),
        "delay": round(episode.delay, 5),
        "palm_error_mm": round(1e3 * float(episode.trace.palm_error[:, 0].max()), 3),
        "arm_error": round(float(off[:, :arm].max()), 5),
        "hand_error": round(float(off[:, arm:].max(initial=0.0)), 5),
    }
