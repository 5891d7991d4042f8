"""Rows of physics in an experiment's folder: those that are not there yet are computed, in several processes."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from dexnudge.experiments.config import ExperimentConfig, Task, all_tasks
from dexnudge.experiments.experiment_rows import PhysicsRow
from dexnudge.experiments.rows import Row, RowWriter, read_lines, read_rows
from dexnudge.jobs.folders import claim_folder, read_claim
from dexnudge.jobs.processes import WorkerDied, run_tasks

Made = TypeVar("Made", bound=PhysicsRow)


@dataclass(frozen=True)
class RowFolder(Generic[Made]):
    """Where rows of one kind are kept.

    Attributes:
        name: in the experiment's folder. file: in there, with the options of the run.
        format_version: of the file and of the rows beside it.
        kind: dataclass of the rows.
    """

    name: str
    file: str
    format_version: int
    kind: type[Made]

    def read(self, out: Path) -> tuple[dict[str, Any], list[Made]]:
        """What the run wrote about itself into the folder of an experiment, and the rows that it has so far.

        Raises:
            InputError: a file is missing, damaged or of another format.
        """
        folder = out / self.name
        return read_claim(folder, self.file, format_version=self.format_version), read_lines(folder, self.kind)


def compute_missing(
    kept: RowFolder[Made],
    config: ExperimentConfig,
    out: Path,
    *,
    options: dict[str, Any],
    make_handler: Callable[[], Callable[[Task], Made]],
    failed: Callable[[Task, str], Made],
    unverified: Callable[[Task, Row], Made],
    workers: int,
    on_row: Callable[[Made, int, int], None] | None,
) -> list[Made]:
    """Compute the rows that are not there yet and return all of them.

    Where the experiment's own row is there and has no verified draw, nothing is drawn again.

    Args:
        kept: their folder.
        config: of the experiment.
        out: its folder; need not hold all of its rows, or any.
        options: what tells this run from another one, besides `config`.
        make_handler: called once in each process; makes what computes a row. Picklable.
        failed: the row of a task that failed for this reason.
        unverified: the row of a task whose own row, which is given, was sampled and has no verified draw.
        workers: number of processes.
        on_row: called with (row, finished, total) for each new row.

    Raises:
        InputError: the folder holds rows of another experiment or with other options.
        OutputError: it cannot be written.
    """
    tasks = all_tasks(config)
    folder = out / kept.name
    claim = {**asdict(config), **options}
    claim_folder(folder, kept.file, claim, format_version=kept.format_version, device=config.device)
    rows = {row.key: row for row in read_lines(folder, kept.kind)}
    known = {row.key: row for row in read_rows(out)}
    with closing(RowWriter(folder)) as writer:

        def add(row: Made) -> None:
            writer.append(row)
            rows[row.key] = row
            if on_row:
                on_row(row, len(rows), len(tasks))

        todo = []
        for task in tasks:
            if task.key in rows:
                continue
            own = known.get(task.key)
            if own is None or any(own.success):
                todo.append(task)
            else:
                add(failed(task, own.reason) if own.status == "failed" else unverified(task, own))
        for task, result in run_tasks(make_handler, todo, workers=workers):
            add(failed(task, result.reason) if isinstance(result, WorkerDied) else result)
    return [rows[task.key] for task in tasks]
