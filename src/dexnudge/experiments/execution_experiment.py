"""The executed rate of an experiment: the best verified draws of each of its rows in physics; resumable."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from dexnudge.experiments.config import ExperimentConfig, Task
from dexnudge.experiments.experiment_maker import ExecutionRowMaker, failed_execution
from dexnudge.experiments.experiment_rows import ExecutionRow
from dexnudge.experiments.missing_rows import RowFolder, compute_missing
from dexnudge.experiments.rows import Row

FOLDER = "executed"  # in the experiment's folder
KEPT = RowFolder(FOLDER, "execution.json", 1, ExecutionRow)


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
    return compute_missing(
        KEPT,
        config,
        out,
        options={"execute_num": num, "execute_errors": errors},
        make_handler=partial(ExecutionRowMaker, config, num, errors=errors),
        failed=partial(failed_execution, config),
        unverified=_nothing_to_execute,
        workers=workers,
        on_row=on_row,
    )


def read_executions(out: Path) -> tuple[dict[str, Any], list[ExecutionRow]]:
    """What `run_executions` wrote about itself into an experiment's folder, and the rows that it has so far.

    Raises:
        InputError: a file is missing, damaged or of another format.
    """
    return KEPT.read(out)


def _nothing_to_execute(task: Task, row: Row) -> ExecutionRow:
    return ExecutionRow(
        object=task.object, scene=task.scene, method=task.method, status="executed", seed=row.seed, drawn=row.num
    )
