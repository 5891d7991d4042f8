"""The report of an experiment's executions, made from their rows: executed.md, executed.json and a calibration plot."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from dexnudge.dataset.schema import BEHAVIOURS
from dexnudge.errors import InputError
from dexnudge.experiments.calibration_chart import calibration_chart
from dexnudge.experiments.execution_experiment import read_executions
from dexnudge.experiments.experiment_lines import (
    ExecutedLine,
    Group,
    calibration,
    changed_rates,
    executed_lines,
    grouped,
    margin_bins,
    per_scene,
)
from dexnudge.experiments.experiment_rows import Executed, ExecutionRow
from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.report import losses_changed, made_with, write_report_files
from dexnudge.experiments.rows import read_rows

REPORT, CHART_FILE = "executed", "calibration.svg"  # .md and .json
ByScene = Mapping[str, Mapping[str, Group]]
GROUPS: dict[str, tuple[Callable[[Executed], str], Sequence[str]]] = {  # title -> name of an execution's group, order
    "behaviour": (lambda each: each.behaviour, BEHAVIOURS),
    "links that touch": (lambda each: str(each.links), [str(number) for number in range(1, 30)]),
    "way to contact": (lambda each: "found" if each.approach else "none, starts at contact", ()),
}
EXPLAINED = (
    "Top-ranked: share of all attempted objects whose best verified draw, the one that a robot would use, succeeds in "
    "physics; an object that failed or has no verified draw counts as one that does not. Executed: the first verified "
    "draws of each, up to {num}, and the share of them that succeeds. In %; in brackets, 95 % intervals by bootstrap over "
    "objects."
)
CALIBRATION_EXPLAINED = (
    "Executed configurations by their force margin, which is at most 3: the largest factor on the surroundings' friction "
    "at which the forces balance."
)
CHANGED_EXPLAINED = (
    "The top-ranked configurations once more, with one quantity of the physics multiplied, while approach and forces were "
    "planned for its nominal value; n is how many were played so."
)


def write_execution_report(out: Path) -> str:
    """Write the files into the folder of an experiment and return the markdown.

    Raises:
        InputError: the folder holds no executions, or damaged ones.
        OutputError: the folder cannot be written.
    """
    claim, rows = read_executions(out)
    if not rows:
        raise InputError(
            f"{out} holds no executions yet; expected a folder that `dexnudge evaluate --execute` worked on"
        )
    lines, bins = executed_lines(rows), calibration(rows)
    groups = {
        title: per_scene(rows, partial(grouped, name=name, order=order)) for title, (name, order) in GROUPS.items()
    }
    changed, differing = per_scene(rows, changed_rates), _drawn_differently(out, rows)
    markdown = _as_markdown(claim, lines, bins, groups, changed, differing)
    numbers = {
        **claim,
        "lines": [vars(line) for line in lines],
        "calibration": _plain(bins),
        "groups": {title: _plain(found) for title, found in groups.items()},
        "changed": _plain(changed),
        "drawn_differently": differing,
    }
    chart = calibration_chart(
        "Executed, by force margin: success in %, and number",
        margin_bins(),
        {**bins} if len(bins) > 2 else {"all": bins["all"]},
    )
    write_report_files(out, markdown, numbers, name=REPORT, others={CHART_FILE: chart})
    return markdown


def _as_markdown(
    claim: dict[str, Any],
    lines: Sequence[ExecutedLine],
    bins: ByScene,
    groups: Mapping[str, ByScene],
    changed: ByScene,
    differing: int,
) -> str:
    config = claim["config"]
    reasons = list(dict.fromkeys(reason for line in lines for reason in line.failures))
    parts = [
        f"# Executed in physics: {Path(config['objects']).name}",
        losses_changed(config) + EXPLAINED.format(num=config["execute_num"]),
        _line_table(lines),
        "## Why executions failed",
        "Executed configurations by reason, and objects that had none." if reasons else "None did.",
        *([_failure_table(lines, reasons)] if reasons else []),
        "## Does the force margin foretell it?",
        f"{CALIBRATION_EXPLAINED} ![calibration]({CHART_FILE})",
        _scene_table("force margin", bins),
    ]
    for name, found in groups.items():
        parts += [f"## By {name}", _scene_table(name, found)]
    if changed["all"]:
        parts += ["## With friction and mass errors", CHANGED_EXPLAINED, _scene_table("setting", changed)]
    if differing:
        parts.append(
            f"{differing} rows were drawn otherwise than the experiment's own ones, as another machine or version does."
        )
    return "\n\n".join([*parts, "## Made with", made_with(claim)]) + "\n"


def _line_table(lines: Sequence[ExecutedLine]) -> str:
    header = ["scene", "method", "objects", "failed", "without verified", "top-ranked", "executed", "of these"]
    rows = [
        [
            line.scene,
            line.method,
            line.objects,
            line.failed,
            line.unverified,
            line.top.percent(),
            line.executed,
            line.single.percent() if line.single else "",
        ]
        for line in lines
    ]
    return markdown_table(header, rows)


def _failure_table(lines: Sequence[ExecutedLine], reasons: Sequence[str]) -> str:
    rows = [[line.scene, line.method, *(line.failures.get(reason, 0) for reason in reasons)] for line in lines]
    return markdown_table(["scene", "method", *reasons], rows)


def _scene_table(name: str, found: ByScene) -> str:
    """A row for each label, a column for each scene."""
    rows = [[label, *(_cell(groups.get(label)) for groups in found.values())] for label in found["all"]]
    return markdown_table([name, *found], rows, names=1)


def _cell(group: Group | None) -> str:
    return "" if group is None else f"{group.rate.percent()}, n = {group.executed}"


def _plain(groups: ByScene) -> dict[str, Any]:
    """Groups as dicts, their estimates kept as such for `as_json`."""
    return {
        key: {label: {**asdict(group), "rate": group.rate} for label, group in found.items()}
        for key, found in groups.items()
    }


def _drawn_differently(out: Path, rows: Sequence[ExecutionRow]) -> int:
    """How many rows have other best margins than the experiment's own rows of the same name, where these are there."""
    own = {row.key: row for row in read_rows(out)}
    return sum(
        row.key in own
        and row.status == "executed"
        and own[row.key].force_margin[: len(row.configurations)] != [each.force_margin for each in row.configurations]
        for row in rows
    )
