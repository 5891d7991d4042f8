"""What an entry is worth: each answer judged by verification and in physics, whatever the entry says of itself.

Geometry and forces decide about every draw (`verify`), physics about the first-ranked one, played in open loop and with
feedback by the same hand, motors and policies for all. A draw that is in something by more than 1 mm, or beyond its joints'
limits, is not played: it fails. Missing, malformed and failed answers stay in the denominators.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

from dexnudge.benchmark.entry import Answer, Entry, load_entry, read_answer
from dexnudge.benchmark.records import REPEATED, ScoreRecord, TaskScore, sealed
from dexnudge.benchmark.repeats import repeated
from dexnudge.benchmark.report import write_report
from dexnudge.benchmark.suite import TaskKey
from dexnudge.benchmark.tasks import TaskSet, load_tasks
from dexnudge.errors import DexnudgeError, InputError
from dexnudge.execution.executor import Executor
from dexnudge.experiments.config import TrialKey
from dexnudge.experiments.records import FILE as RECORDS
from dexnudge.experiments.records import RecordWriter, read_records
from dexnudge.hands.hand import Hand
from dexnudge.jobs.claims import claim_folder, read_claim
from dexnudge.jobs.folders import owned_folder
from dexnudge.jobs.processes import WorkerDied, run_tasks
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.feedback import Feedback
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.open_loop import OpenLoop
from dexnudge.verification.verdicts import Verdicts, verify

FILE, FORMAT_VERSION, ENTRIES = "score.json", 2, "entries"
PLAYABLE = ("", "contact", "force_margin", "motion_not_blocked")  # what may fail of a draw that is played


def judge(scene: Scene, hand: Hand, answer: Answer, task: str) -> TaskScore:
    """Return what an answer is worth in its scene.

    Raises:
        MeshError: MuJoCo cannot take the object or the surroundings.
    """
    verdicts = verify(scene, hand, answer.q)
    again = repeated(answer.q, hand)
    counted = verdicts.success & ~again
    reasons = verdicts.take(~again).rejections()
    found = TaskScore(
        task=task,
        drawn=len(answer.q),
        verified=int(counted.sum()),
        first=bool(counted[0]),
        reasons=reasons | ({REPEATED: int(again.sum())} if again.any() else {}),
        rejected=_rejected(verdicts),
        problem=next((f"draw {row}: {what}" for row, what in answer.wrong.items()), ""),
    )
    if verdicts.reasons[0] not in PLAYABLE:
        return found
    simulation = scene_model(hand, scene)
    executor = Executor(scene, simulation, OpenLoop())
    first, others = answer.q[0], answer.q[1:][counted[1:]]
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

    OUT/entries/NAME/results.jsonl has a line for each object and family, which counts where its seal is of these answers;
    OUT/report.html, .md, .csv, .json and a chart
    compare entries.
    on_record: called with the entry, finished and total.

    Raises:
        InputError: a suite or an entry that cannot be read, two entries of one name, an entry in `out`, or one that was
            changed since.
        OutputError: `out` cannot be written, or another run works on it.
    """
    tasks, out = load_tasks(suite), Path(out)
    given = [load_entry(folder, tasks) for folder in entries]
    names = [entry.name for entry in given]
    if not names or len({*names}) < len(names):
        raise InputError(f"the entries are {', '.join(names) or 'none'}; expected one or more, each of its own name")
    for entry in given:
        _check_apart(entry.folder.resolve(), out, out / ENTRIES / entry.name)
    with owned_folder(out):
        for entry in given:
            _score_entry(entry, tasks, out / ENTRIES / entry.name, workers, on_record)
        found = [record for name in names for record in read_records(out / ENTRIES / name, ScoreRecord)]
        claims = {name: read_claim(out / ENTRIES / name, FILE, format_version=FORMAT_VERSION) for name in names}
        return write_report(given, tasks, found, claims, out)


def _check_apart(entry: Path, out: Path, scores: Path) -> None:
    """Refuse an entry among the scores, or scores within it: records that came with it would be taken for the judge's."""
    if entry.is_relative_to(out.resolve()) or scores.resolve().is_relative_to(entry):
        raise InputError(
            f"the entry {entry} and its scores, {scores}, lie in each other; expected folders apart; move the entry, or "
            "choose another `out`"
        )


def _score_entry(
    entry: Entry, tasks: TaskSet, out: Path, workers: int, on_record: Callable[[str, int, int], None] | None
) -> None:
    suite, stamp = tasks.fingerprint, entry.hash
    claim = {"suite": suite, "entry": stamp, "name": entry.name}
    changed = (
        f"the entry '{entry.name}' was changed since it was judged in {out}; expected it as it was; choose another `out`, "
        "or remove that folder"
    )
    claim_folder(out, FILE, claim, format_version=FORMAT_VERSION, device="cpu", changed={"entry": changed})
    groups = _groups(tasks, entry)
    there = read_records(out, ScoreRecord)
    kept = [record for record in there if record.key in groups and record == sealed(record, suite, stamp)]
    if len(kept) < len(there):
        (out / RECORDS).unlink()
    done = {record.key for record in kept}
    waiting = [key for key in groups if key not in done]
    with closing(RecordWriter(out)) as writer:
        for record in kept if len(kept) < len(there) else []:
            writer.append(record)
        start = partial(_start, entry.folder, tasks.folder)
        for number, (key, result) in enumerate(run_tasks(start, waiting, workers=workers), start=len(done) + 1):
            record = _died(key, result, groups[key], tasks, entry) if isinstance(result, WorkerDied) else result
            writer.append(sealed(record, suite, stamp))
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


def _died(key: TrialKey, worker: WorkerDied, group: list[TaskKey], tasks: TaskSet, entry: Entry) -> ScoreRecord:
    return _record(key, [TaskScore(task.name, problem=worker.reason) for task in group], tasks, entry)


def _record(key: TrialKey, found: list[TaskScore], tasks: TaskSet, entry: Entry) -> ScoreRecord:
    return ScoreRecord(
        **key._asdict(),
        status="done" if any(task.answered for task in found) else "failed",
        reason="; ".join(dict.fromkeys(task.problem for task in found if task.problem)),
        seed=0,
        num=tasks.suite.draws * len(found),
        verified=sum(task.verified for task in found),
        seconds={task.task: float(entry.seconds[task.task]) for task in found if task.task in entry.seconds},
        tasks=found,
    )
