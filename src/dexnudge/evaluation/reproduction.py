"""The experiments that stand for the paper's tables, and for what they lack, as one resumable run.

Each part of the run is an experiment in a folder of its own, so that it goes on where it was stopped.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError
from dexnudge.evaluation.claimed_folder import claim_folder, read_claim
from dexnudge.evaluation.experiment_config import ExperimentConfig, all_tasks
from dexnudge.evaluation.experiments import run_experiment
from dexnudge.evaluation.rows import Row, read_rows

FILE = "reproduction.json"
FORMAT_VERSION = 1

TABLES = (  # what Tables I and II of the paper compare, and the bar that a learned prior has to clear
    "ours",
    "guidance_only",
    "grasp_projection",
    "random_start_projection",
    "paper",
    "paper_guidance_only",
)
RULES = ("best_of_32", "unguided_projection")  # choice without guidance, and neither
FURTHER = ("ours_one_particle", "spherical", "clean_gradient", "unguided")
FROM_DATA = "nearest_pose"
QUICK_WITHOUT_BASE = TABLES[:4]
QUICK_NUM, FULL_NUM = 16, 32
QUICK_OBJECTS = 30  # at 14 s of one core for the rows of an object and scene: about 11 minutes on two cores
WITH_BASE, WITHOUT_BASE, GRASPS_ONLY = "with_base", "without_base", "grasps_only"


@dataclass(frozen=True, kw_only=True)
class ReproductionConfig:
    """What is reproduced.

    Attributes:
        objects, max_objects, scenes, num, seed, units, length, weights, data: as in `ExperimentConfig`. Without `data`,
            `nearest_pose` is left out, and the report says so.
        grasp_weights: folder of a model that was trained on grasps only; None leaves that row out.
        quick: fewer methods.
    """

    objects: str = "builtin:test"
    max_objects: int | None = None
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    num: int = FULL_NUM
    seed: int = 0
    units: str = "m"
    length: float | None = None
    weights: str | None = None
    grasp_weights: str | None = None
    data: str | None = None
    quick: bool = False


@dataclass(frozen=True)
class Part:
    """One experiment of the run: the folder below the run's, a heading, and what is evaluated."""

    folder: str
    title: str
    config: ExperimentConfig


def parts(config: ReproductionConfig) -> list[Part]:
    """The experiments of a run, in the order in which they are worked on."""
    with_base = TABLES + RULES + (() if config.quick else FURTHER) + ((FROM_DATA,) if config.data else ())
    without_base = QUICK_WITHOUT_BASE if config.quick else TABLES
    found = [
        Part(WITH_BASE, "With the forearm", _experiment(config, with_base, base=True)),
        Part(WITHOUT_BASE, "Without the forearm", _experiment(config, without_base, base=False)),
    ]
    if config.grasp_weights:
        grasps = _experiment(config, ("grasp_projection",), base=True, weights=config.grasp_weights)
        found.append(Part(GRASPS_ONLY, "A model trained on grasps only", grasps))
    return found


def left_out(config: ReproductionConfig) -> list[str]:
    """Rows that this run does not have, and what they need."""
    missing = []
    if not config.data:
        missing.append(f"{FROM_DATA}: needs a dataset, --data DIR")
    if not config.grasp_weights:
        missing.append("a model trained on grasps only: needs its folder, --grasp-weights DIR")
    if config.quick:
        missing += [f"{method}: left out by --quick" for method in FURTHER]
    return missing


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
    claim_folder(out, FILE, asdict(config), format_version=FORMAT_VERSION, device="cpu")
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
    config = ReproductionConfig(**{**claim["config"], "scenes": tuple(claim["config"]["scenes"])})
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


def _experiment(
    config: ReproductionConfig, methods: tuple[str, ...], *, base: bool, weights: str | None = None
) -> ExperimentConfig:
    return ExperimentConfig(
        objects=config.objects,
        max_objects=config.max_objects,
        scenes=config.scenes,
        methods=methods,
        num=config.num,
        seed=config.seed,
        units=config.units,
        length=config.length,
        base=base,
        weights=weights or config.weights,
        data=config.data if FROM_DATA in methods else None,
        sweep=True,
    )
