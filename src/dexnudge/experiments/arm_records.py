"""What is recorded and reported of plans for an arm."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from dexnudge.experiments.metrics import FAILED, OBJECTS, UNVERIFIED, Metric, share
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.statistics import mean_of_known, quantile_estimate
from dexnudge.planning.outcomes import Outcome
from dexnudge.trajectories.planner import Failure

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


METRICS: Sequence[Metric] = (
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
        lambda records: share(lambda each: each.executed)(records) if any(each.outcome for each in records) else None,
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
