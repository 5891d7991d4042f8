"""The report of a reproduction: report.md for people, report.json for programs, and plots."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dexnudge.errors import OutputError
from dexnudge.experiments.equal_time import EqualTime, equal_time, equal_time_table
from dexnudge.experiments.failure_section import failure_section
from dexnudge.experiments.interval_chart import interval_chart
from dexnudge.experiments.line_tables import measure_table, rate_table, rejection_table, seconds_table
from dexnudge.experiments.lines import Line, summarise
from dexnudge.experiments.main_tables import main_table, model_table
from dexnudge.experiments.method_names import method_name, method_table
from dexnudge.experiments.paper_tables import table_1, table_2
from dexnudge.experiments.rejected_pictures import picture_rejected
from dexnudge.experiments.report import COLUMNS_EXPLAINED, MEASURES_EXPLAINED, made_with, write_report_files
from dexnudge.experiments.reproduction import Reproduction, read_reproduction
from dexnudge.experiments.reproduction_parts import (
    GENERALISATION,
    HARD,
    PREDICTIONS,
    RANDOM_START,
    STEERED_NOISE,
    WITH_BASE,
    Part,
    left_out,
)
from dexnudge.experiments.rows import Row
from dexnudge.experiments.sweep_lines import SweepLine, setting_text, sweep_lines, sweep_table
from dexnudge.experiments.worst_cases import worst_cases

PLOTS = "plots"
OWN_PARTS = (WITH_BASE, HARD, GENERALISATION)  # the forearm included, with the run's own weights
SWEPT = (STEERED_NOISE, RANDOM_START)  # whose sweeps the text shows; report.json has all
FEW, MANY_PARTS = 2, "the paper's tables and baselines"  # parts that fit into a title, and what more are called
HOW_TO_READ = (
    "Success is the judge's: exact geometry, both ways, and a force balance; docs/conventions.md has the rule. One draw of "
    "dexnudge is one pass, with no choice among several. Random start + projection has no learned prior."
)
ABOUT_THE_PAPER = (
    "The paper gives one outcome for each of its objects, in its own scenes and by a criterion without a formula: its "
    "columns orient, and no more."
)
ABOUT_TIME = (
    "How many draws each method verifies in the time that dexnudge takes for its draws of one object once the scene is "
    "prepared: counts are scaled to that time, since draws are independent. Ratio: verified draws per second over those "
    "of random start + projection; none where that verifies nothing. Spreads are those of the verified draws."
)
ABOUT_SWEEPS = (
    "The same draws judged again where one quantity is multiplied; nothing is drawn anew. Top-ranked: the one that was "
    "ranked first at the values for which it was drawn."
)


class _PartReport:
    """The figures of one part of the run."""

    def __init__(self, part: Part, rows: Sequence[Row]) -> None:
        self.part, self.failed = part, [row for row in rows if row.status == "failed"]
        self.lines: list[Line] = summarise(rows)
        self.sweeps: list[SweepLine] = sweep_lines(rows)
        can = {STEERED_NOISE, RANDOM_START} <= set(part.config.methods)
        self.comparisons: list[EqualTime] = equal_time(rows, STEERED_NOISE, RANDOM_START) if can else []

    def sections(self) -> list[str]:
        """Its headings and tables."""
        found = [f"## {self.part.title}: all rows", rate_table(self.lines), measure_table(self.lines)]
        found += [f"### {self.part.title}: why draws were rejected", rejection_table(self.lines)]
        return [*found, f"### {self.part.title}: seconds per object, scene and method", seconds_table(self.lines)]

    def plots(self) -> dict[str, str]:
        """File name -> SVG."""
        title, name, scenes = self.part.title, self.part.folder, dict.fromkeys(line.scene for line in self.lines)
        by_scene = {scene: [line for line in self.lines if line.scene == scene] for scene in scenes}
        single, speed = (
            {
                scene: {method_name(line.method): getattr(line, key) for line in lines}
                for scene, lines in by_scene.items()
            }
            for key in ("single", "verified_per_second")
        )
        swept = [line for line in self.sweeps if line.method == STEERED_NOISE]
        settings = {
            scene: {setting_text(line.setting): line.single for line in swept if line.scene == scene}
            for scene in scenes
        }
        charts = {
            "single": interval_chart(f"{title}: a single draw succeeds [%]", single, limit=1.0, factor=100.0),
            "speed": interval_chart(f"{title}: verified per second, preparation included", speed),
        }
        if swept:
            heading = f"{title}: a single draw of dexnudge at other frictions and masses [%]"
            charts["sweeps"] = interval_chart(heading, settings, limit=1.0, factor=100.0)
        return {f"{name}-{kind}.svg": svg for kind, svg in charts.items()}

    def as_json(self) -> dict[str, list[dict[str, Any]]]:
        """Its figures, each with the part that it belongs to."""
        label = {"part": self.part.folder}
        return {
            "lines": [label | vars(line) for line in self.lines],
            "sweeps": [label | vars(line) for line in self.sweeps],
            "equal_time": [label | vars(each) for each in self.comparisons],
        }


def write_reproduction_report(folder: Path) -> str:
    """Write report.md, report.json and the plots into the folder of a finished run, and return the markdown.

    Draws the cases that are shown as failures again, for their pictures.

    Raises:
        InputError: the folder holds no finished run.
        OutputError: the folder cannot be written.
    """
    run = read_reproduction(folder)
    reports = [_PartReport(part, rows) for part, rows in run.parts]
    plots = {name: svg for report in reports for name, svg in report.plots().items()}
    try:
        (folder / PLOTS).mkdir(exist_ok=True)
        for name, svg in plots.items():
            (folder / PLOTS / name).write_text(svg, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write the plots into {folder}: {error.strerror or error}") from error
    cases = worst_cases([(part, rows) for part, rows in run.parts if part.folder in OWN_PARTS], STEERED_NOISE)
    failures = failure_section(cases, picture_rejected(cases, folder / PLOTS), PLOTS)
    markdown = _as_markdown(run, reports, list(plots), failures)
    content: dict[str, Any] = {**run.claim, "left_out": left_out(run.config)}
    for report in reports:
        for key, entries in report.as_json().items():
            content[key] = [*content.get(key, []), *entries]
    write_report_files(folder, markdown, content)
    return markdown


def _as_markdown(
    run: Reproduction, reports: Sequence[_PartReport], plots: Sequence[str], failures: Sequence[str]
) -> str:
    config = run.config
    by_title = {report.part.title.lower(): report.lines for report in reports}
    own = [report for report in reports if report.part.folder in OWN_PARTS]
    objects = max(line.objects for report in reports for line in report.lines)
    draws = f"{config.num} draws for each object, scene and method, seed {config.seed}, hand shadow_lite"
    sections = [
        f"# Success on {Path(config.objects).name}: {', '.join(by_title) if len(by_title) <= FEW else MANY_PARTS}",
        f"{objects} objects, {draws}. {HOW_TO_READ}",
        COLUMNS_EXPLAINED,
        "## Main table",
        main_table([line for report in own for line in report.lines]),
        "## Methods",
        method_table(line.method for report in reports for line in report.lines),
        "## Table I",
        ABOUT_THE_PAPER,
        table_1(by_title),
        "## Table II",
        table_2(by_title),
        *_model_section(reports),
        *_equal_time_section(reports),
        *_sweep_section(reports),
        *failures,
        "## Plots",
        *(f"![{Path(name).stem}]({PLOTS}/{name})" for name in plots),
        "## Measures",
        MEASURES_EXPLAINED,
        *(section for report in reports for section in report.sections()),
        "## Not in this run",
        "\n".join(f"- {line}" for line in left_out(config)) or "Nothing is missing.",
        "## Objects that failed",
        _failed_objects(reports) or "None.",
        "## Made with",
        made_with(run.claim),
    ]
    return "\n\n".join(sections) + "\n"


def _model_section(reports: Sequence[_PartReport]) -> list[str]:
    others = [report for report in reports if report.part.folder.startswith(f"{PREDICTIONS}-")]
    if not others:
        return []
    own = [report for report in reports if report.part.folder == WITH_BASE]
    models = {"the run's own": own[0].lines if own else []}
    models |= {report.part.title: report.lines for report in others}
    return ["## Prediction types and other weights", model_table(models)]


def _equal_time_section(reports: Sequence[_PartReport]) -> list[str]:
    tables = [(report.part.title, equal_time_table(report.comparisons)) for report in reports if report.comparisons]
    found = [text for title, table in tables for text in (f"### {title}", table)]
    return ["## At equal time on the wall clock", ABOUT_TIME, *found] if found else []


def _sweep_section(reports: Sequence[_PartReport]) -> list[str]:
    swept = [line for report in reports for line in report.sweeps if line.method in SWEPT]
    return ["## Other frictions and masses", ABOUT_SWEEPS, sweep_table(swept)] if swept else []


def _failed_objects(reports: Sequence[_PartReport]) -> str:
    """One line for each object and scene; the draws stay in every denominator."""
    reasons = {(row.object, row.scene): row.reason for report in reports for row in report.failed}
    return "\n".join(f"- {name}, {scene}: {reason}" for (name, scene), reason in reasons.items())
