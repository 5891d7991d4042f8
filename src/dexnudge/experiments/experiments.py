"""Success of sampling methods over many objects and scenes: resumable, in several processes."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from dexnudge.experiments.config import ExperimentConfig, all_tasks
from dexnudge.experiments.row_maker import RowMaker, failed_row
from dexnudge.experiments.rows import Row, RowWriter, read_rows
from dexnudge.jobs.folders import claim_folder, read_claim
from dexnudge.jobs.processes import WorkerDied, run_tasks

FILE = "experiment.json"
FORMAT_VERSION = 2  # of the file and of the rows beside it


def run_experiment(
    config: ExperimentConfig,
    out: Path,
    *,
    workers: int = 2,
    on_row: Callable[[Row, int, int], None] | None = None,
) -> list[Row]:
    """Compute the rows that `out` does not have yet and return all of them.

    Args:
        config: what is evaluated.
        out: folder of the experiment; made when it does not exist. One that holds another experiment is refused.
        workers: number of processes.
        on_row: called with (row, finished, total) for each new row.

    Raises:
        InputError: `out` holds another experiment; a name or count in the config is not valid.
        OutputError: `out` cannot be written.
    """
    tasks = all_tasks(config)
    claim_folder(out, FILE, asdict(config), format_version=FORMAT_VERSION, device=config.device)
    rows = {row.key: row for row in read_rows(out)}
    todo = [task for task in tasks if task.key not in rows]
    with closing(RowWriter(out)) as writer:
        work = partial(RowMaker, config)
        for task, result in run_tasks(work, todo, workers=workers, together=lambda task: (task.object, task.scene)):
            if isinstance(result, WorkerDied):
                row = failed_row(config, task, f"the worker process died with exit code {result.exit_code}")
            else:
                row = result
            writer.append(row)
            rows[row.key] = row
            if on_row:
                on_row(row, len(rows), len(tasks))
    return [rows[task.key] for task in tasks]


def read_experiment(folder: Path) -> dict[str, Any]:
    """What `run_experiment` wrote about itself: format_version, config, versions, machine.

    Raises:
        InputError: the file is missing, damaged or of another format.
    """
    return read_claim(folder, FILE, format_version=FORMAT_VERSION)
