"""The tables of an experiment, made from its rows: report.md for people, report.json for programs."""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, OutputError
from dexnudge.evaluation.experiments import read_experiment
from dexnudge.evaluation.rows import Row, read_rows
from dexnudge.evaluation.statistics import bootstrap_interval
from dexnudge.evaluation.success import ROBUST_MARGIN

MARKDOWN_FILE, JSON_FILE = "report.md", "report.json"
COLUMNS = (
    "objects",
    "failed",
    "draws",
    "single",
    "single robust",
    "first",
    "top-ranked",
    "top-ranked robust",
    "any of n",
    "verified/s",
)


@dataclass(frozen=True)
class Rate:
    """A share of what was attempted, with its 95 % interval over objects."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{100 * self.value:.1f} ({100 * self.low:.0f}-{100 * self.high:.0f})"


@dataclass(frozen=True)
class Line:
    """One scene and method over all attempted objects.

    Attributes:
        objects, failed: attempted, and those of them that could not be read or did not fit the scene.
        samples: draws attempted, those of failed objects included.
        single: share of all draws that succeed.
        single_robust: share of all draws that succeed with a force margin of at least 1.5.
        first: share of objects whose first draw in the sampler's own order, before verification, succeeds.
        top: share of objects whose top-ranked draw, the one that a robot would use, succeeds.
        top_robust: the same with a force margin of at least 1.5.
        any: share of objects with at least one draw that succeeds.
        rejected: draws by reason; those of failed objects under "object failed".
        seconds: mean per sampled row, by stage.
        verified_per_second: over the time of all stages but loading.
    """

    scene: str
    method: str
    objects: int
    failed: int
    samples: int
    single: Rate
    single_robust: Rate
    first: Rate
    top: Rate
    top_robust: Rate
    any: Rate
    rejected: dict[str, int]
    seconds: dict[str, float]
    verified_per_second: float


def write_report(folder: Path) -> str:
    """Write both files into the folder of an experiment and return the markdown.

    Raises:
        InputError: the folder holds no rows, or damaged ones.
        OutputError: the folder cannot be written.
    """
    experiment, rows = read_experiment(folder), read_rows(folder)
    if not rows:
        raise InputError(f"{folder} holds no rows yet; expected a folder that `dexnudge evaluate` has worked on")
    lines = summarise(rows)
    markdown = as_markdown(lines, experiment)
    content = {**experiment, "lines": [_line_as_json(line) for line in lines]}
    try:
        (folder / MARKDOWN_FILE).write_text(markdown, encoding="utf-8")
        (folder / JSON_FILE).write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write the report into {folder}: {error.strerror or error}") from error
    return markdown


def summarise(rows: list[Row]) -> list[Line]:
    """One line for each scene and method, in the order of their first rows."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.method), []).append(row)
    return [_line(scene, method, group) for (scene, method), group in groups.items()]


def as_markdown(lines: list[Line], experiment: dict[str, Any]) -> str:
    """The report as text; rates in percent with 95 % intervals over objects."""
    config, machine, versions = experiment["config"], experiment["machine"], experiment["versions"]
    base = "" if config["base"] else " without base"
    explanation = (
        f"{config['num']} draws for each object and scene, seed {config['seed']}, hand {config['hand']}{base}. Rates in "
        "% of what was attempted; in brackets, 95 % intervals by bootstrap over objects. Top-ranked: verified ones "
        "first, best first. First: the sampler's own first choice, before verification."
    )
    parts = [
        f"# Success on {config['objects']}",
        explanation,
        _markdown_table(["scene", "method", *COLUMNS], [[line.scene, line.method, *_cells(line)] for line in lines]),
        "## Why draws were rejected",
        _count_table(lines),
        "## Seconds per object, scene and method",
        _seconds_table(lines),
        "## Made with",
        "; ".join(f"{key} {value}" for key, value in {**machine, **versions}.items()),
    ]
    return "\n\n".join(parts) + "\n"


def _cells(line: Line) -> list[str]:
    """The entries of a line under `COLUMNS`."""
    counts = [line.objects, line.failed, line.samples]
    rates = [line.single, line.single_robust, line.first, line.top, line.top_robust, line.any]
    return [*map(str, counts), *map(str, rates), f"{line.verified_per_second:.1f}"]


def _line(scene: str, method: str, rows: list[Row]) -> Line:
    sampled = [row for row in rows if row.status == "sampled"]
    rejected: Counter[str] = Counter()
    seconds: Counter[str] = Counter()
    for row in rows:
        rejected.update(row.rejected if row.status == "sampled" else {"object failed": row.num})
    for row in sampled:
        seconds.update(row.seconds)
    verified = sum(sum(row.success) for row in sampled)
    spent = sum(value for stage, value in seconds.items() if stage != "load")
    return Line(
        scene=scene,
        method=method,
        objects=len(rows),
        failed=len(rows) - len(sampled),
        samples=sum(row.num for row in rows),
        single=_rate([_share(row, row.success) for row in rows]),
        single_robust=_rate([_share(row, _robust(row)) for row in rows]),
        first=_rate([_first(row) for row in rows]),
        top=_rate([float(any(row.success[:1])) for row in rows]),
        top_robust=_rate([float(any(_robust(row)[:1])) for row in rows]),
        any=_rate([float(any(row.success)) for row in rows]),
        rejected=dict(rejected.most_common()),
        seconds={stage: value / len(sampled) for stage, value in seconds.items()},
        verified_per_second=verified / spent if spent else 0.0,
    )


def _rate(values: list[float]) -> Rate:
    """Mean over objects, which is the share over draws, as every object has the same number of draws."""
    array: Float[np.ndarray, " n"] = np.array(values)
    low, high = bootstrap_interval(array)
    return Rate(float(array.mean()), float(low), float(high))


def _share(row: Row, flags: list[bool]) -> float:
    return sum(flags) / row.num


def _robust(row: Row) -> list[bool]:
    return [ok and margin >= ROBUST_MARGIN for ok, margin in zip(row.success, row.force_margin, strict=True)]


def _first(row: Row) -> float:
    return float(any(ok for ok, rank in zip(row.success, row.own_rank, strict=True) if rank == 0))


def _line_as_json(line: Line) -> dict[str, Any]:
    return {key: vars(value) if isinstance(value, Rate) else value for key, value in vars(line).items()}


def _count_table(lines: list[Line]) -> str:
    reasons = list(dict.fromkeys(reason for line in lines for reason in line.rejected))
    if not reasons:
        return "None were."
    rows = [[line.scene, line.method, *(line.rejected.get(reason, 0) for reason in reasons)] for line in lines]
    return _markdown_table(["scene", "method", *reasons], rows)


def _seconds_table(lines: list[Line]) -> str:
    stages = list(dict.fromkeys(stage for line in lines for stage in line.seconds))
    rows = [[line.scene, line.method, *(f"{line.seconds.get(stage, 0.0):.2f}" for stage in stages)] for line in lines]
    return _markdown_table(["scene", "method", *stages], rows)


def _markdown_table(header: list[str], rows: list[list[Any]]) -> str:
    marks = ["---", "---", *["---:"] * (len(header) - 2)]
    return "\n".join("| " + " | ".join(map(str, cells)) + " |" for cells in [header, marks, *rows])
