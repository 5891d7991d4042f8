"""What the judge found, task by task, and the figures that are made of it."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

from dexnudge.experiments.metrics import OBJECTS, Metric, share
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.statistics import Estimate, quantile_estimate
from dexnudge.jobs.digests import digest
from dexnudge.verification.criteria import VALID_POSE
from dexnudge.version import __version__

ALL = "all"  # families, in tables
NOT_PLAYED = "not played"  # outcome of a first draw that is in something, or beyond limits
REPEATED = "repeated"  # why a draw fails that is an earlier one once more, see `repeats`


@dataclass(frozen=True)
class TaskScore:
    """What an answer is worth.

    Attributes:
        task: its name. drawn: draws in the answer. verified: how many succeed.
        first: whether the first succeeds. reasons: draws by what they fail for, see `Verdicts.reasons`; also `REPEATED`.
        open_loop, feedback: value of the `Outcome` of the first draw in physics, or `NOT_PLAYED`.
        rejected: what the first draw fails for, and how deep it penetrates; "" where it succeeds.
        problem: why there is no valid answer, or what is wrong with its first malformed draw; "" for nothing.
    """

    task: str
    drawn: int = 0
    verified: int = 0
    first: bool = False
    reasons: dict[str, int] = field(default_factory=dict)
    open_loop: str = NOT_PLAYED
    feedback: str = NOT_PLAYED
    rejected: str = ""
    problem: str = ""

    @property
    def answered(self) -> bool:
        """Whether some draw has a pose."""
        return self.drawn > self.reasons.get(VALID_POSE.name, 0)


@dataclass(frozen=True, kw_only=True)
class ScoreRecord(TrialRecord):
    """All tasks of an object in a family of scenes; `method` is the entry's name, `num` the draws that they allow.

    Attributes:
        tasks: what each answer is worth.
        judge: version of dexnudge that judged.
        seal: SHA-256 of the suite, the entry with its answers, and the other fields; see `sealed`.
    """

    kind: ClassVar[str] = "benchmark"

    tasks: list[TaskScore] = field(default_factory=list)
    judge: str = __version__
    seal: str = ""


def sealed(record: ScoreRecord, suite: str, entry: str) -> ScoreRecord:
    """Return the record with the seal of this suite and entry, by their hashes: it is of no others."""
    return replace(record, seal=digest({**asdict(record), "seal": "", "of": [suite, entry]}))


Records = Sequence[ScoreRecord]


def _of_tasks(good: Callable[[TaskScore], bool]) -> Callable[[Records], Any]:
    return share(lambda each: sum(map(good, each.tasks)) / len(each.tasks))


def _failures(records: Records) -> dict[str, int]:
    """Draws by what they fail for; draws that a task allows and that are not there as "missing"."""
    counts: Counter[str] = Counter()
    for record in records:
        counts["missing"] += record.num - sum(task.drawn for task in record.tasks)
        for task in record.tasks:
            counts.update({reason.replace("_", " "): number for reason, number in task.reasons.items()})
    return {name: number for name, number in counts.most_common() if number}


def _median_seconds(records: Records) -> Estimate | None:
    """Return the median over answered tasks; None where one of them has no time: the quick ones alone would flatter."""
    times = [each.seconds.get(task.task) for each in records for task in each.tasks if task.answered]
    known = [seconds for seconds in times if seconds is not None]
    return quantile_estimate(known, 0.5) if len(known) == len(times) else None


def _outcomes(records: Records) -> dict[str, int]:
    return dict(Counter(task.feedback.replace("_", " ") for record in records for task in record.tasks).most_common())


METRICS = (
    OBJECTS,
    Metric("tasks", lambda records: sum(len(each.tasks) for each in records), "tasks", 0),
    Metric("answered", lambda records: sum(task.answered for each in records for task in each.tasks), "answered", 0),
    Metric("first", _of_tasks(lambda task: task.first), "first verified"),
    Metric("share", share(lambda each: each.verified / each.num), "share verified"),
    Metric("any", _of_tasks(lambda task: task.verified > 0), "any verified"),
    Metric("open_loop", _of_tasks(lambda task: task.open_loop == "success"), "open loop"),
    Metric("feedback", _of_tasks(lambda task: task.feedback == "success"), "feedback"),
    Metric(
        "seconds",
        _median_seconds,
        "s",
        1,
    ),
    Metric("failures", _failures, "Why draws fail", "counts"),
    Metric("outcomes", _outcomes, "How first draws end in physics, with feedback", "counts"),
)


def merged(records: Records) -> list[ScoreRecord]:
    """Return one record of each object and entry, for all families together: an object is resampled as a whole."""
    merged: dict[tuple[str, str], ScoreRecord] = {}
    for each in records:
        so_far = merged.get((each.object, each.method))
        merged[each.object, each.method] = replace(
            each,
            scene=ALL,
            num=each.num + (so_far.num if so_far else 0),
            verified=each.verified + (so_far.verified if so_far else 0),
            tasks=[*(so_far.tasks if so_far else []), *each.tasks],
            seconds={**(so_far.seconds if so_far else {}), **each.seconds},
        )
    return list(merged.values())
