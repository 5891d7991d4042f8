"""The executed rate of an experiment: the best verified draws of each of its rows in physics; resumable."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from dexnudge.evaluation.claimed_folder import claim_folder, read_claim
from dexnudge.evaluation.experiment_config import ExperimentConfig, Task, all_tasks
from dexnudge.evaluation.rows import Row, RowWriter, read_lines, read_rows
from dexnudge.execution.experiment_maker import ExecutionRowMaker, failed_execution
from dexnudge.execution.experiment_rows import ExecutionRow
from dexnudge.jobs.answers import WorkerDied
from dexnudge.jobs.processes import run_tasks

FOLDER = "executed"  # in the experiment's folder
FILE = "execution.json"
FORMAT_VERSION = 1  # of the file and of the rows beside it


def run_executions(
    config: ExperimentConfig,
    out: Path,
    *,
    num: int = 1,
    errors: bool = False,
    workers: int = 2,
    on_row: Callable[[ExecutionRow, int, int], None] | None = None,
) -> list[ExecutionRow]:
    """Compute the rows that `out`/executed does not have yet and return all of them.

    A row is drawn again with the experiment's seed, which gives the draws of the experiment's own row. Where that row is
    there and has no verified draw, nothing is drawn.

    Args:
        config: of the experiment.
        out: its folder; need not hold all of its rows, or any.
        num: verified draws of each row to execute, best first.
        errors: whether the best one is also played with other frictions and masses, see `experiment_maker.ERRORS`.
        workers: number of processes.
        on_row: called with (row, finished, total) for each new row.

    Raises:
        InputError: `out`/executed holds executions of another experiment or with other options.
        OutputError: it cannot be written.
    """
    tasks = all_tasks(config)
    folder = out / FOLDER
    options = {**asdict(config), "execute_num": num, "execute_errors": errors}
    claim_folder(folder, FILE, options, format_version=FORMAT_VERSION, device=config.device)
    rows = {row.key: row for row in read_lines(folder, ExecutionRow)}
    known = {row.key: row for row in read_rows(out)}
    with closing(RowWriter(folder)) as writer:

        def add(row: ExecutionRow) -> None:
            writer.append(row)
            rows[row.key] = row
            if on_row:
                on_row(row, len(rows), len(tasks))

        todo = []
        for task in tasks:
            if task.key in rows:
                continue
            if task.key in known and not any(known[task.key].success):
                add(_nothing_to_execute(config, task, known[task.key]))
            else:
                todo.append(task)
        for task, result in run_tasks(partial(ExecutionRowMaker, config, num, errors=errors), todo, workers=workers):
            add(failed_execution(config, task, result.reason) if isinstance(result, WorkerDied) else result)
    return [rows[task.key] for task in tasks]


def read_executions(out: Path) -> tuple[dict[str, Any], list[ExecutionRow]]:
    """What `run_executions` wrote about itself into an experiment's folder, and the rows that it has so far.

    Raises:
        InputError: a file is missing, damaged or of another format.
    """
    folder = out / FOLDER
    return read_claim(folder, FILE, format_version=FORMAT_VERSION), read_lines(folder, ExecutionRow)


def _nothing_to_execute(config: ExperimentConfig, task: Task, row: Row) -> ExecutionRow:
    if row.status == "failed":
        return failed_execution(config, task, row.reason)
    return ExecutionRow(
        object=task.object, scene=task.scene, method=task.method, status="executed", seed=row.seed, drawn=row.num
    )
