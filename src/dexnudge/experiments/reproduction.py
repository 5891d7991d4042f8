"""The experiments that stand for the paper's tables, and for what they lack, as one resumable run.

Each part of the run is an experiment in a folder of its own, so that it goes on where it was stopped.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError
from dexnudge.experiments.config import all_tasks
from dexnudge.experiments.experiments import run_experiment
from dexnudge.experiments.reproduction_parts import Part, ReproductionConfig, parts
from dexnudge.experiments.rows import Row, read_rows
from dexnudge.jobs.folders import claim_folder, read_claim

FILE = "reproduction.json"
FORMAT_VERSION = 2


def run_reproduction(
    config: ReproductionConfig,
    out: Path,
    *,
    workers: int = 2,
    on_row: Callable[[Row, int, int], None] | None = None,
) -> None:
    """Compute the rows that `out` does not have yet.

    Args:
        config: what is reproduced.
        out: folder of the run; made when it does not exist. One that holds something else is refused.
        workers: number of processes.
        on_row: called with (row, finished, total) for each new row, counted over all parts.

    Raises:
        InputError: `out` holds another run; a name or count in the config is not valid.
        OutputError: `out` cannot be written.
    """
    sizes = [len(all_tasks(part.config)) for part in parts(config)]
    claim_folder(out, FILE, config.as_json(), format_version=FORMAT_VERSION, device="cpu")
    before = 0
    for part, size in zip(parts(config), sizes, strict=True):

        def show(row: Row, finished: int, _: int, before: int = before) -> None:
            if on_row:
                on_row(row, before + finished, sum(sizes))

        run_experiment(part.config, out / part.folder, workers=workers, on_row=show)
        before += size


@dataclass(frozen=True)
class Reproduction:
    """A finished run: its options, what `run_reproduction` wrote about itself, and each part with all of its rows."""

    config: ReproductionConfig
    claim: dict[str, Any]
    parts: list[tuple[Part, list[Row]]]


def read_reproduction(folder: Path) -> Reproduction:
    """The finished run in a folder, rows in the order of its tasks.

    Raises:
        InputError: no such run, a damaged one, or one that is not finished.
    """
    claim = read_claim(folder, FILE, format_version=FORMAT_VERSION)
    config = ReproductionConfig.from_json(claim["config"])
    found = []
    for part in parts(config):
        rows = {row.key: row for row in read_rows(folder / part.folder)}
        tasks = all_tasks(part.config)
        missing = [task for task in tasks if task.key not in rows]
        if missing:
            raise InputError(
                f"{folder} is not finished: {len(missing)} of {len(tasks)} rows of {part.folder} are missing (first: "
                f"{', '.join(missing[0].key)}); run `dexnudge reproduce` with the same options and --out again"
            )
        found.append((part, [rows[task.key] for task in tasks]))
    return Reproduction(config, claim, found)
