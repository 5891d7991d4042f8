"""The report of an experiment's lifts, made from their rows: lifted.md and lifted.json."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError
from dexnudge.execution.grasp_and_lift import HOLD_TIME, LIFT
from dexnudge.experiments.lift_experiment import read_lifts
from dexnudge.experiments.lift_experiment_lines import LiftLine, lift_lines
from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.report import losses_changed, made_with, write_report_files
from dexnudge.experiments.statistics import Estimate

REPORT = "lifted"  # .md and .json
EXPLAINED = (
    "In one simulation each object is slid by its verified draws, best first, to where it can be grasped, grasped there, "
    "lifted by {lift:g} cm and held for {hold:g} s. Lifted: share of all attempted objects with which that comes off within "
    "{tries}, each of which goes on from where the one before has left hand and object; first try: the share without "
    "retries. An object that failed, has no verified draw or cannot be slid to where it is graspable counts as one that is "
    "not lifted. In %; in brackets, 95 % intervals by bootstrap over objects. Tries and seconds: mean over the objects that "
    "were played."
)


def write_lift_report(out: Path) -> str:
    """Write both files into the folder of an experiment and return the markdown.

    Raises:
        InputError: the folder holds no lifts, or damaged ones.
        OutputError: the folder cannot be written.
    """
    claim, rows = read_lifts(out)
    if not rows:
        raise InputError(f"{out} holds no lifts yet; expected a folder that `dexnudge evaluate --then-grasp` worked on")
    lines = lift_lines(rows)
    markdown = _as_markdown(claim, lines)
    write_report_files(out, markdown, {**claim, "lines": [vars(line) for line in lines]}, name=REPORT)
    return markdown


def _as_markdown(claim: dict[str, Any], lines: Sequence[LiftLine]) -> str:
    config = claim["config"]
    tries = "1 try" if config["tries"] == 1 else f"{config['tries']} tries"
    parts = [
        f"# Slid, grasped, lifted: {Path(config['objects']).name}",
        losses_changed(config) + EXPLAINED.format(lift=100 * LIFT, hold=HOLD_TIME, tries=tries),
        _line_table(lines),
        "## Why objects were not lifted",
        "Objects by what went wrong at their last try.",
        _failure_table(lines, lambda line: line.failures),
        "## Why first tries failed",
        _failure_table(lines, lambda line: line.first_failures),
        "## Made with",
        made_with(claim),
    ]
    return "\n\n".join(parts) + "\n"


def _line_table(lines: Sequence[LiftLine]) -> str:
    header = ["scene", "method", "objects", "failed", "without verified", "lifted", "first try", "tries"]
    rows = [
        [
            line.scene,
            line.method,
            line.objects,
            line.failed,
            line.unverified,
            line.lifted.percent(),
            line.at_first.percent(),
            *(_value(each) for each in (line.tries, line.draw, line.play, line.simulated)),
        ]
        for line in lines
    ]
    return markdown_table([*header, "draw [s]", "play [s]", "simulated [s]"], rows)


def _value(estimate: Estimate | None) -> str:
    return "" if estimate is None else f"{estimate.value:.1f}"


def _failure_table(lines: Sequence[LiftLine], failures: Callable[[LiftLine], dict[str, int]]) -> str:
    reasons = list(dict.fromkeys(reason for line in lines for reason in failures(line)))
    if not reasons:
        return "None did."
    rows = [[line.scene, line.method, *(failures(line).get(reason, 0) for reason in reasons)] for line in lines]
    return markdown_table(["scene", "method", *reasons], rows)
