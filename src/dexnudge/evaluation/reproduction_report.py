"""The report of a reproduction: the paper's tables, all rows, sweeps, equal time; report.md, report.json and plots."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dexnudge.errors import OutputError
from dexnudge.evaluation.equal_time import EqualTime, equal_time, equal_time_table
from dexnudge.evaluation.interval_chart import interval_chart
from dexnudge.evaluation.line_tables import measure_table, rate_table, rejection_table, seconds_table
from dexnudge.evaluation.lines import Line, summarise
from dexnudge.evaluation.paper_tables import table_1, table_2
from dexnudge.evaluation.report import COLUMNS_EXPLAINED, MEASURES_EXPLAINED, made_with, write_report_files
from dexnudge.evaluation.reproduction import FROM_DATA, Part, Reproduction, left_out, read_reproduction
from dexnudge.evaluation.rows import Row
from dexnudge.evaluation.sweep_lines import SweepLine, sweep_lines, sweep_table

PLOTS = "plots"
OURS, RANDOM_START = "ours", "random_start_projection"
BASELINES = (RANDOM_START, FROM_DATA)
SWEPT = (OURS, RANDOM_START)  # whose sweeps the text shows; report.json has all
ABOUT_THE_PAPER = (
    "The paper gives one outcome for each of its objects, in its own scenes and by a criterion without a formula: its "
    "columns orient, and no more."
)
ABOUT_TIME = (
    "Verified draws in the time that the first method takes for its draws of one object once the scene is prepared; the "
    "other's count is scaled to that time, since its draws are independent. Per second: preparing the scene included."
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
        methods = part.config.methods
        against = [name for name in BASELINES if name in methods and OURS in methods]
        self.comparisons: list[EqualTime] = [each for name in against for each in equal_time(rows, OURS, name)]

    def sections(self) -> list[str]:
        """Its headings and tables."""
        found = [f"## {self.part.title}: all rows", rate_table(self.lines), measure_table(self.lines)]
        if self.comparisons:
            title = f"### {self.part.title}: equal time on the wall clock"
            found += [title, ABOUT_TIME, equal_time_table(self.comparisons)]
        swept = [line for line in self.sweeps if line.method in SWEPT]
        if swept:
            found += [f"### {self.part.title}: other frictions and masses", ABOUT_SWEEPS, sweep_table(swept)]
        found += [f"### {self.part.title}: why draws were rejected", rejection_table(self.lines)]
        return [*found, f"### {self.part.title}: seconds per object, scene and method", seconds_table(self.lines)]

    def plots(self) -> dict[str, str]:
        """File name -> SVG."""
        title, name, scenes = self.part.title, self.part.folder, dict.fromkeys(line.scene for line in self.lines)
        by_scene = {scene: [line for line in self.lines if line.scene == scene] for scene in scenes}
        single = {scene: {line.method: line.single for line in lines} for scene, lines in by_scene.items()}
        speed = {scene: {line.method: line.verified_per_second for line in lines} for scene, lines in by_scene.items()}
        swept = [line for line in self.sweeps if line.method == OURS]
        settings = {scene: {line.setting: line.single for line in swept if line.scene == scene} for scene in scenes}
        found = {
            f"{name}-single.svg": interval_chart(
                f"{title}: a single draw succeeds [%]", single, limit=1.0, factor=100.0
            ),
            f"{name}-speed.svg": interval_chart(f"{title}: verified configurations per second", speed),
        }
        if swept:
            heading = f"{title}: a single draw of ours, judged at other frictions and masses [%]"
            found[f"{name}-sweeps.svg"] = interval_chart(heading, settings, limit=1.0, factor=100.0)
        return found

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

    Raises:
        InputError: the folder holds no finished run.
        OutputError: the folder cannot be written.
    """
    run = read_reproduction(folder)
    reports = [_PartReport(part, rows) for part, rows in run.parts]
    plots = {name: svg for report in reports for name, svg in report.plots().items()}
    markdown = _as_markdown(run, reports, list(plots))
    try:
        (folder / PLOTS).mkdir(exist_ok=True)
        for name, svg in plots.items():
            (folder / PLOTS / name).write_text(svg, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write the plots into {folder}: {error.strerror or error}") from error
    content: dict[str, Any] = {**run.claim, "left_out": left_out(run.config)}
    for report in reports:
        for key, entries in report.as_json().items():
            content[key] = [*content.get(key, []), *entries]
    write_report_files(folder, markdown, content)
    return markdown


def _as_markdown(run: Reproduction, reports: Sequence[_PartReport], plots: Sequence[str]) -> str:
    config = run.config
    by_title = {report.part.title.lower(): report.lines for report in reports}
    objects = max(line.objects for report in reports for line in report.lines)
    sections = [
        f"# The paper's tables and more, on {config.objects}",
        f"{objects} objects, {config.num} draws for each object, scene and method, seed {config.seed}. {COLUMNS_EXPLAINED}",
        "## Table I",
        ABOUT_THE_PAPER,
        table_1(by_title),
        "## Table II",
        table_2(by_title),
        "## Plots",
        *(f"![{Path(name).stem}]({PLOTS}/{name})" for name in plots),
        "## Measures",
        MEASURES_EXPLAINED,
        *(section for report in reports for section in report.sections()),
        "## Not in this run",
        "\n".join(f"- {line}" for line in left_out(config)) or "Nothing is missing.",
        "## Objects that failed",
        _failures(reports) or "None.",
        "## Made with",
        made_with(run.claim),
    ]
    return "\n\n".join(sections) + "\n"


def _failures(reports: Sequence[_PartReport]) -> str:
    """One line for each object and scene; the draws stay in every denominator."""
    reasons = {(row.object, row.scene): row.reason for report in reports for row in report.failed}
    return "\n".join(f"- {name}, {scene}: {reason}" for (name, scene), reason in reasons.items())
