"""The report of an experiment, made from its rows: report.md for people, report.json for programs."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError, OutputError
from dexnudge.experiments.experiments import read_experiment
from dexnudge.experiments.line_tables import measure_table, rate_table, rejection_table, seconds_table
from dexnudge.experiments.lines import Line, summarise
from dexnudge.experiments.method_names import method_table
from dexnudge.experiments.rows import read_rows
from dexnudge.experiments.statistics import as_json

REPORT = "report"  # .md and .json
COLUMNS_EXPLAINED = (
    "Rates in % of what was attempted; in brackets, 95 % intervals by bootstrap over objects. Top-ranked: verified ones "
    "first, best first; top of k: of k draws, mean over all choices of k. First: the sampler's own first choice, before "
    "verification. Robust: with a force margin of at least 1.5."
)
MEASURES_EXPLAINED = (
    "Worst depth: the deepest of object, surroundings and hand itself. Depth and margin: median over an object's draws, "
    "mean over objects; 95th percentile: over all draws. Spread: of verified draws, mean over the objects with at least "
    "two. Joint spread: standard deviation, mean over the joints. Contact spread: mean distance of the fingertips' "
    "contact places from their mean."
)


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
    write_report_files(folder, markdown, {**experiment, "lines": [vars(line) for line in lines]})
    return markdown


def write_report_files(
    folder: Path, markdown: str, content: dict[str, Any], *, name: str = REPORT, others: Mapping[str, str] | None = None
) -> None:
    """Write a report's text and its numbers, NAME.md and NAME.json, and other files of text; OutputError when that fails."""
    numbers = json.dumps(as_json(content), indent=2, allow_nan=False)
    texts = {f"{name}.md": markdown, f"{name}.json": numbers + "\n", **(others or {})}
    try:
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write the report into {folder}: {error.strerror or error}") from error


def as_markdown(lines: list[Line], experiment: dict[str, Any]) -> str:
    """The report as text."""
    config = experiment["config"]
    base = "" if config["base"] else " without base"
    draws = f"{config['num']} draws for each object and scene, seed {config['seed']}, hand {config['hand']}{base}."
    losses = losses_changed(config)
    parts = [
        f"# Success on {Path(config['objects']).name}",
        f"{draws} {losses}{COLUMNS_EXPLAINED}",
        rate_table(lines),
        "## Methods",
        method_table(line.method for line in lines),
        "## Depth, force, variety, cost",
        MEASURES_EXPLAINED,
        measure_table(lines),
        "## Why draws were rejected",
        rejection_table(lines),
        "## Seconds per object, scene and method",
        seconds_table(lines),
        "## Made with",
        made_with(experiment),
    ]
    return "\n\n".join(parts) + "\n"


def losses_changed(config: dict[str, Any]) -> str:
    """A sentence, and the space after it, on losses that are other than the methods' own; "" where none is."""
    changed = config.get("losses") or {}
    text = ", ".join(f"{name} {value:g}" for name, value in changed.items())
    return f"Losses other than each method's own: {text}. " if text else ""


def made_with(claim: dict[str, Any]) -> str:
    """Machine and versions in one line."""
    return "; ".join(f"{key} {value}" for key, value in {**claim["machine"], **claim["versions"]}.items())
