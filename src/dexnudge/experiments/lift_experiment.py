"""The lifted rate of an experiment: slide, grasp and lift with the verified draws of each of its rows; resumable."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.experiment_lines import UNVERIFIED
from dexnudge.experiments.lift_experiment_maker import LiftRowMaker, failed_lift
from dexnudge.experiments.lift_experiment_rows import LiftRow
from dexnudge.experiments.missing_rows import RowFolder, compute_missing

FOLDER = "lifted"  # in the experiment's folder
KEPT = RowFolder(FOLDER, "lifting.json", 1, LiftRow)


def run_lifts(
    config: ExperimentConfig,
    out: Path,
    *,
    tries: int = 3,
    workers: int = 2,
    on_row: Callable[[LiftRow, int, int], None] | None = None,
) -> list[LiftRow]:
    """Compute the rows that `out`/lifted does not have yet and return all of them.

    A row is drawn again with the experiment's seed, which gives the draws of the experiment's own row. Where that row is
    there and has no verified draw, nothing is drawn.

    Args:
        config: of the experiment.
        out: its folder; need not hold all of its rows, or any.
        tries: most tries of each story, see `slide_grasp_lift`.
        workers: number of processes.
        on_row: called with (row, finished, total) for each new row.

    Raises:
        InputError: `out`/lifted holds lifts of another experiment or with other options.
        CheckpointError: no weights for this hand.
        OutputError: it cannot be written.
    """
    return compute_missing(
        KEPT,
        config,
        out,
        options={"tries": tries},
        make_handler=partial(LiftRowMaker, config, tries),
        failed=partial(failed_lift, config),
        unverified=lambda task, row: failed_lift(config, task, UNVERIFIED, drawn=row.num),
        workers=workers,
        on_row=on_row,
    )


def read_lifts(out: Path) -> tuple[dict[str, Any], list[LiftRow]]:
    """What `run_lifts` wrote about itself into an experiment's folder, and the rows that it has so far.

    Raises:
        InputError: a file is missing, damaged or of another format.
    """
    return KEPT.read(out)
