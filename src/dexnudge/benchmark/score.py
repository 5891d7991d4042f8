"""What an entry is worth: each answer judged by verification and in physics, whatever the entry says of itself.

Geometry and forces decide about every draw (`verify`), physics about the first-ranked one, played in open loop and with
feedback by the same hand, motors and policies for all. A draw that is in something by more than 1 mm, or beyond its joints'
limits, is not played: it fails. Missing, malformed and failed answers stay in the denominators.
"""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from dexnudge.benchmark.entry import Answer, Entry, load_entry, read_answer
from dexnudge.benchmark.suite import TaskKey
from dexnudge.benchmark.tasks import TaskSet, load_tasks
from dexnudge.errors import DexnudgeError, InputError, printable
from dexnudge.execution.executor import Executor
from dexnudge.experiments.config import TrialKey
from dexnudge.experiments.metrics import OBJECTS, Metric, measure, share
from dexnudge.experiments.records import RecordWriter, TrialRecord, read_records
from dexnudge.experiments.report import FEW, FEWEST, made_with, write_files
from dexnudge.experiments.statistics import quantile_estimate
from dexnudge.experiments.tables import count_table, interval_chart, metric_table
from dexnudge.experiments.trial import Section
from dexnudge.hands.hand import Hand
from dexnudge.jobs.claims import claim_folder, read_claim
from dexnudge.jobs.folders import owned_folder
from dexnudge.jobs.processes import WorkerDied, run_tasks
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.feedback import Feedback
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.open_loop import OpenLoop
from dexnudge.verification.verdicts import Verdicts, verify

FILE, FORMAT_VERSION, ENTRIES = "score.json", 1, "entries"
ALL = "all"  # families, in tables
MOST_LISTED = 20  # rejected first draws in the report
NOT_PLAYED = "not played"  # outcome of a first draw that is in something, or beyond limits
MARKUP = re.compile(r"[\\`*\[\]|]|(?<![^\W_])_|_(?![^\W_])")  # of Markdown; not "_" within a word
PLAYABLE = ("", "contact", "force_margin", "motion_not_blocked")  # what may fail of a draw that is played
ABOUT = (
    "% of all tasks, those without a valid answer among them; in brackets 95 % intervals by bootstrap over objects. First: "
    "the draw that the method ranks first, verified by geometry and forces. Share: of the {draws} draws that a task allows, "
    "missing ones count as failures. Open loop, feedback: the first draw played out in physics. Seconds: median of a task, "
    "as each entry says."
)


@dataclass(frozen=True)
class TaskScore:
    """What an answer is worth.

    Attributes:
        task: its name. drawn: draws in the answer. verified: how many succeed.
        first: whether the first succeeds. reasons: draws by what they fail for, see `Verdicts.reasons`.
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


@dataclass(frozen=True, kw_only=True)
class ScoreRecord(TrialRecord):
    """All tasks of an object in a family of scenes; `method` is the entry's name, `num` the draws that they allow."""

    kind: ClassVar[str] = "benchmark"

    tasks: list[TaskScore] = field(default_factory=list)


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


def _outcomes(records: Records) -> dict[str, int]:
    return dict(Counter(task.feedback.replace("_", " ") for record in records for task in record.tasks).most_common())


METRICS = (
    OBJECTS,
    Metric("tasks", lambda records: sum(len(each.tasks) for each in records), "tasks", 0),
    Metric("answered", lambda records: sum(task.drawn > 0 for each in records for task in each.tasks), "answered", 0),
    Metric("first", _of_tasks(lambda task: task.first), "first verified"),
    Metric("share", share(lambda each: each.verified / each.num), "share verified"),
    Metric("any", _of_tasks(lambda task: task.verified > 0), "any verified"),
    Metric("open_loop", _of_tasks(lambda task: task.open_loop == "success"), "open loop"),
    Metric("feedback", _of_tasks(lambda task: task.feedback == "success"), "feedback"),
    Metric(
        "seconds",
        lambda records: quantile_estimate([s for each in records for s in each.seconds.values()], 0.5),
        "s",
        1,
    ),
    Metric("failures", _failures, "Why draws fail", "counts"),
    Metric("outcomes", _outcomes, "How first draws end in physics, with feedback", "counts"),
)


def judge(scene: Scene, hand: Hand, answer: Answer, task: str) -> TaskScore:
    """Return what an answer is worth in its scene.

    Raises:
        MeshError: MuJoCo cannot take the object or the surroundings.
    """
    verdicts = verify(scene, hand, answer.q)
    found = TaskScore(
        task=task,
        drawn=len(answer.q),
        verified=int(verdicts.success.sum()),
        first=bool(verdicts.success[0]),
        reasons=verdicts.rejections(),
        rejected=_rejected(verdicts),
        problem=next((f"draw {row}: {what}" for row, what in answer.wrong.items()), ""),
    )
    if verdicts.reasons[0] not in PLAYABLE:
        return found
    simulation = scene_model(hand, scene)
    executor = Executor(scene, simulation, OpenLoop())
    first, others = answer.q[0], answer.q[1:][verdicts.success[1:]]
    execution = executor(first)
    feedback = executor.with_policy(Feedback()).again(first, execution, simulation, others)
    return replace(found, open_loop=execution.verdict.outcome.value, feedback=feedback.outcome.value)


def _rejected(verdicts: Verdicts) -> str:
    """Return what the first configuration fails for, and how deep it penetrates where that is what it fails for."""
    reason = verdicts.reasons[0]
    by = f" by {1e3 * verdicts.values[reason][0]:.1f} mm" if reason.startswith("penetration") else ""
    return reason.replace("_", " ") + by


def score(
    entries: Sequence[Path | str],
    suite: Path | str,
    out: Path | str,
    *,
    workers: int = 2,
    on_record: Callable[[str, int, int], None] | None = None,
) -> str:
    """Judge entries and write the table over all of them; return its text. What was judged before is not judged again.

    OUT/entries/NAME/results.jsonl has a line for each object and family; OUT/report.md, .csv, .json and a chart compare
    entries.
    on_record: called with the entry, finished and total.

    Raises:
        InputError: a suite or an entry that cannot be read, two entries of one name, or an entry that was changed since.
        OutputError: `out` cannot be written, or another run works on it.
    """
    tasks, out = load_tasks(suite), Path(out)
    given = [load_entry(folder, tasks) for folder in entries]
    names = [entry.name for entry in given]
    if not names or len({*names}) < len(names):
        raise InputError(f"the entries are {', '.join(names) or 'none'}; expected one or more, each of its own name")
    with owned_folder(out):
        for entry in given:
            _score_entry(entry, tasks, out / ENTRIES / entry.name, workers, on_record)
        return _write_report(given, tasks, out)


def _score_entry(
    entry: Entry, tasks: TaskSet, out: Path, workers: int, on_record: Callable[[str, int, int], None] | None
) -> None:
    claim = {"suite": tasks.fingerprint, "entry": entry.hash, "name": entry.name}
    changed = (
        f"the entry '{entry.name}' was changed since it was judged in {out}; expected it as it was; choose another `out`, "
        "or remove that folder"
    )
    claim_folder(out, FILE, claim, format_version=FORMAT_VERSION, device="cpu", changed={"entry": changed})
    groups = _groups(tasks, entry)
    done = {record.key for record in read_records(out, ScoreRecord)}
    waiting = [key for key in groups if key not in done]
    with closing(RecordWriter(out)) as writer:
        start = partial(_start, entry.folder, tasks.folder)
        for number, (key, result) in enumerate(run_tasks(start, waiting, workers=workers), start=len(done) + 1):
            if isinstance(result, WorkerDied):
                failed = [TaskScore(task.name, problem=result.reason) for task in groups[key]]
                writer.append(_record(key, failed, tasks, entry))
            else:
                writer.append(result)
            if on_record:
                on_record(entry.name, number, len(groups))


def _groups(tasks: TaskSet, entry: Entry) -> dict[TrialKey, list[TaskKey]]:
    groups: dict[TrialKey, list[TaskKey]] = {}
    for task in tasks.tasks:
        groups.setdefault(TrialKey(task.object, task.family, entry.name), []).append(task)
    return groups


def _start(entry_folder: Path, suite_folder: Path) -> Callable[[TrialKey], ScoreRecord]:
    """In a worker: the function that judges the tasks of an object in a family."""
    tasks = load_tasks(suite_folder)
    entry = load_entry(entry_folder, tasks)
    groups = _groups(tasks, entry)

    def run(key: TrialKey) -> ScoreRecord:
        found = []
        for task in groups[key]:
            try:
                answer = read_answer(entry, task.name, tasks.hand, most=tasks.suite.draws)
                found.append(judge(tasks.scene(task), tasks.hand, answer, task.name))
            except DexnudgeError as error:
                found.append(TaskScore(task.name, problem=str(error)))
        return _record(key, found, tasks, entry)

    return run


def _record(key: TrialKey, found: list[TaskScore], tasks: TaskSet, entry: Entry) -> ScoreRecord:
    return ScoreRecord(
        **key._asdict(),
        status="done" if any(task.drawn for task in found) else "failed",
        reason="; ".join(dict.fromkeys(task.problem for task in found if task.problem)),
        seed=0,
        num=tasks.suite.draws * len(found),
        verified=sum(task.verified for task in found),
        seconds={task.task: float(entry.seconds[task.task]) for task in found if task.task in entry.seconds},
        tasks=found,
    )


def _write_report(entries: Sequence[Entry], tasks: TaskSet, out: Path) -> str:
    records = [record for entry in entries for record in read_records(out / ENTRIES / entry.name, ScoreRecord)]
    records.sort(key=lambda record: ([*tasks.suite.families].index(record.scene), record.object))
    measured = [*measure(_merged(records), METRICS), *measure(records, METRICS)]
    claim = read_claim(out / ENTRIES / entries[0].name, FILE, format_version=FORMAT_VERSION)
    counts = [metric for metric in METRICS if metric.form == "counts"]
    suite = tasks.suite
    setting = (
        f"Suite {suite.name}, version {suite.version}: {len(tasks.tasks)} tasks, hand {suite.hand}, fingerprint "
        f"`{tasks.fingerprint[:16]}`; judged by dexnudge {claim['versions']['dexnudge']}, {claim['machine']['processor']}."
    )
    few = FEW if len(suite.objects) < FEWEST else ""
    titles = {"first": "first draw verified", "feedback": "first draw in physics, with feedback"}
    charts = {
        title: {row["method"]: row[name] for row in measured if row["scene"] == ALL} for name, title in titles.items()
    }
    problems = [
        f"- {each.method}, {task.task}: {_as_text(task.problem)}"
        for each in records
        for task in each.tasks
        if task.problem
    ]
    rejected = [
        f"- {each.method}, {task.task}: {task.rejected}" for each in records for task in each.tasks if task.rejected
    ]
    if len(rejected) > MOST_LISTED:
        rejected[MOST_LISTED:] = [f"- and {len(rejected) - MOST_LISTED} more: `{ENTRIES}/NAME/results.jsonl` has all"]
    about = [_as_text(f"- {each.name}: {each.authors}; used: {each.used}; machine: {each.machine}") for each in entries]
    sections = [
        Section(
            "",
            f"{setting} {ABOUT.format(draws=suite.draws)}{few}",
            metric_table(measured, [metric for metric in METRICS if metric not in counts]),
        ),
        Section("Rates", "", chart=("rates.png", lambda: interval_chart(f"Benchmark {suite.name}", charts))),
        Section("Entries", "\n".join(about)),
        *(Section(metric.header, "", count_table(measured, metric.name)) for metric in counts),
        *([Section("First draws that are rejected", "\n".join(rejected))] if rejected else []),
        *([Section("Answers that are missing or malformed", "\n".join(problems))] if problems else []),
        Section("Made with", made_with(claim)),
    ]
    numbers = {"suite": asdict(suite), "fingerprint": tasks.fingerprint, "metrics": measured}
    return write_files(out, f"Benchmark {suite.name}", sections, numbers, measured)


def _as_text(text: str) -> str:
    """Return what an entry says as Markdown that shows it in one line: nothing in it is markup."""
    return MARKUP.sub(r"\\\g<0>", escape(printable(" ".join(text.splitlines())), quote=False))


def _merged(records: Records) -> list[ScoreRecord]:
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
