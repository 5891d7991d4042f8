"""Success of sampling methods over many objects and scenes: resumable, in several processes."""

import json
import time
import zlib
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.errors import DexnudgeError, InputError, OutputError, UnknownNameError
from dexnudge.evaluation.draws import JudgedDraws, draw_and_judge
from dexnudge.evaluation.provenance import machine, versions
from dexnudge.evaluation.rows import Row, RowKey, RowWriter, read_rows
from dexnudge.evaluation.workers import WorkerDied, run_tasks

FILE = "experiment.json"
FORMAT_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """What is evaluated; two runs with equal configs and versions give the same rows.

    Attributes:
        objects: a set as in `resolve_object_set`.
        scenes: names of scene families.
        methods: names in `sampling.METHODS`.
        num: draws for each object, scene and method.
        seed: of the whole experiment; the seed of a row is derived from it, the object and the scene, so that all
            methods meet the same scenes.
        units: of mesh files, unless the set implies a scale.
        length: longest side of every object [m], or None for the size that the set implies.
        hand: built-in name or URDF file.
        base: whether the forearm counts as part of the hand.
        physics: parameters of `build_scene` that differ from the defaults.
        weights: folder of the model, None for the shipped one.
        device: where sampling runs.
    """

    objects: str
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    methods: tuple[str, ...] = ("ours",)
    num: int = 32
    seed: int = 0
    units: str = "m"
    length: float | None = None
    hand: str = "shadow_lite"
    base: bool = True
    physics: dict[str, float] | None = None
    weights: str | None = None
    device: str = "cpu"


@dataclass(frozen=True)
class Task:
    """One row that is still to be computed."""

    object: str
    scene: str
    method: str

    @property
    def key(self) -> RowKey:
        """What identifies the row."""
        return (self.object, self.scene, self.method)


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
    names = _check(config)
    _claim(out, config)
    tasks = [Task(name, scene, method) for name in names for scene in config.scenes for method in config.methods]
    rows = {row.key: row for row in read_rows(out)}
    todo = [task for task in tasks if task.key not in rows]
    with closing(RowWriter(out)) as writer:
        for task, result in run_tasks(partial(RowMaker, config), todo, workers=workers):
            if isinstance(result, WorkerDied):
                row = failed_row(config, task, f"the worker process died with exit code {result.exit_code}")
            else:
                row = result
            writer.append(row)
            rows[row.key] = row
            if on_row:
                on_row(row, len(rows), len(tasks))
    return [rows[task.key] for task in tasks]


class RowMaker:
    """Computes rows one after another, with the hand and the weights loaded once."""

    def __init__(self, config: ExperimentConfig) -> None:
        from dexnudge.hands.registry import load_hand
        from dexnudge.objects.sets import resolve_object_set
        from dexnudge.sampling.loading import load_sampler

        self._config = config
        entries = resolve_object_set(config.objects, units=config.units, length=config.length)
        self._objects = {entry.name: entry for entry in entries}
        self._hand = load_hand(config.hand, base=config.base)
        self._sampler = load_sampler(self._hand, config.methods, weights=config.weights, device=config.device)

    def __call__(self, task: Task) -> Row:
        """The row of a task. An object that cannot be read or does not fit its scene gives a failed row."""
        from dexnudge.scenes.families import build_scene

        config, seed = self._config, row_seed(self._config.seed, task)
        start = time.perf_counter()
        try:
            mesh = self._objects[task.object].load()
            scene = build_scene(task.scene, mesh, seed=seed, **(config.physics or {}))
            scene.validate()
        except DexnudgeError as error:
            return failed_row(config, task, f"{type(error).__name__}: {error}")
        loading = time.perf_counter() - start
        draws = draw_and_judge(self._sampler, self._hand, scene, num=config.num, seed=seed, method=task.method)
        return sampled_row(task, draws, seed=seed, loading=loading)


def sampled_row(task: Task, draws: JudgedDraws, *, seed: int, loading: float) -> Row:
    """The row of a task whose draws are judged; `loading` are the seconds before the first draw."""
    verdicts = draws.verdicts
    deepest = np.maximum.reduce(
        [verdicts.penetration_object, verdicts.penetration_environment, verdicts.penetration_self]
    )
    return Row(
        object=task.object,
        scene=task.scene,
        method=task.method,
        status="sampled",
        num=len(draws.q),
        seed=seed,
        success=verdicts.success.tolist(),
        force_margin=[round(float(margin), 4) for margin in verdicts.force_margin],
        penetration_mm=[round(1e3 * depth, 4) if np.isfinite(depth) else None for depth in deepest.tolist()],
        own_rank=draws.own_rank.tolist(),
        rejected=draws.rejections(),
        seconds={stage: round(value, 4) for stage, value in {"load": loading, **draws.seconds}.items()},
    )


def failed_row(config: ExperimentConfig, task: Task, reason: str) -> Row:
    """A row that counts as `num` draws without success."""
    return Row(
        object=task.object,
        scene=task.scene,
        method=task.method,
        status="failed",
        reason=reason,
        num=config.num,
        seed=row_seed(config.seed, task),
    )


def row_seed(seed: int, task: Task) -> int:
    """Seed of a row: the same for all methods, another for each object and scene."""
    parts = [seed, zlib.crc32(task.object.encode()), zlib.crc32(task.scene.encode())]
    return int(np.random.SeedSequence(parts).generate_state(1)[0])


def _check(config: ExperimentConfig) -> list[str]:
    """Names of the objects; InputError when something in the config is not valid."""
    from dexnudge.objects.sets import resolve_object_set
    from dexnudge.sampling.methods import METHODS
    from dexnudge.scenes.families import SCENE_FAMILIES

    if config.num < 1:
        raise InputError(f"--num is {config.num}; expected at least 1")
    _check_names("scene", config.scenes, SCENE_FAMILIES)
    _check_names("method", config.methods, METHODS)
    return [entry.name for entry in resolve_object_set(config.objects, units=config.units, length=config.length)]


def _check_names(what: str, names: Sequence[str], table: Any) -> None:
    if not names:
        raise InputError(f"no {what} is named; expected some of {', '.join(table)}")
    for name in names:
        if name not in table:
            raise UnknownNameError(f"unknown {what} {name!r}; expected some of {', '.join(table)}")
        if list(names).count(name) > 1:
            raise InputError(f"the {what} {name!r} is named twice; expected each once")


def read_experiment(folder: Path) -> dict[str, Any]:
    """What `run_experiment` wrote about itself: format_version, config, versions, machine.

    Raises:
        InputError: the file is missing or damaged.
    """
    path = folder / FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} cannot be read ({error}); expected the file that `dexnudge evaluate` wrote"
        ) from error
    if not isinstance(content, dict) or content.get("format_version") != FORMAT_VERSION:
        raise InputError(f"{path} is of another format; expected format_version {FORMAT_VERSION}; choose another --out")
    return content


def _claim(out: Path, config: ExperimentConfig) -> None:
    """Make `out` the folder of this experiment, or see that it already is."""
    path = out / FILE
    ours = json.loads(json.dumps(asdict(config)))
    if path.is_file():
        theirs = read_experiment(out)["config"]
        differing = [key for key in ours if theirs.get(key) != ours[key]]
        if differing:
            key = differing[0]
            raise InputError(
                f"{out} holds another experiment: {key} is {theirs.get(key)!r} there and {ours[key]!r} here; "
                "expected equal options to go on with it; choose another --out"
            )
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out} exists and holds no experiment; expected a new folder; choose another --out")
    content = {
        "format_version": FORMAT_VERSION,
        "config": ours,
        "versions": versions(),
        "machine": machine(config.device),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".partial")
        unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error.strerror or error}; choose another --out") from error
