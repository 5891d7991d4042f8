"""Runs what is published, and writes docs/data/*.csv, docs/results.md, docs/images and the README's table from it.

The list of runs is published_runs.yaml. Pages are written from docs/data alone, so that one run can be published anew
without the folders of the others.
"""

import csv
import json
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
import yaml

from dexnudge.experiments.comparisons import MAIN, PAPER_SUCCESS, STEERED_NOISE
from dexnudge.experiments.reproduction import HARD_SCENES, NEW_SCENES
from dexnudge.experiments.tables import Table, csv_text

ROOT = Path(__file__).parents[1]
RUNS = Path(__file__).with_name("published_runs.yaml")
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
HANDS_BEGIN, HANDS_END = "<!-- hands:begin -->", "<!-- hands:end -->"
ARM_BEGIN, ARM_END = "<!-- arm:begin -->", "<!-- arm:end -->"
KINDS = ("", "executed", "lifted", "arm")  # folders of a run that may hold a report
WITH_BASE = "with_base"
SHOWN = {  # columns of the page: name in docs/data -> header
    "single": "single draw",
    "single_robust": "robust",
    "top": "top-ranked",
    "top_robust": "top-ranked robust",
    "length_asked_mm": "length asked, mm",
    "length_reached_mm": "reached, mm",
    "lifted": "lifted",
    "at_first": "at the first attempt",
    "verified_per_second": "verified/s",
}
LABELS = {  # of methods, on the pages
    "steered_noise": "dexnudge",
    "resampled": "dexnudge, resampled",
    "guidance_only": "dexnudge, not projected",
    "random_start_projection": "random start + projection",
}
ARM_SHOWN = {  # columns of the table of arms
    "planned": "planned, %",
    "plan_median": "planning, median s",
    "plan_most": "90 %, s",
    "executed": "executed, % of attempted",
    "executed_of_planned": "of planned",
    "palm_error_mm": "tracking, mm",
}
OPEN_LOOP = ", open loop"  # at the end of a group's name
LIMITS, DEPTHS = ("position", "velocity", "acceleration", "jerk"), ("in_object_mm", "in_environment_mm", "in_itself_mm")
NOT_PERCENT = {  # digits
    "length_asked_mm": 0,
    "length_reached_mm": 0,
    "verified_per_second": 1,
    "joint_diversity": 2,
    "plan_median": 1,
    "plan_most": 1,
    "palm_error_mm": 1,
}
FIGURES = (  # that matter: what, run, kind, column
    ("single draw verified, %", "test42", "", "single"),
    ("single draw verified and robust, %", "test42", "", "single_robust"),
    ("top-ranked verified, %", "test42", "", "top"),
    ("top-ranked verified and robust, %", "test42", "", "top_robust"),
    ("top-ranked executed in physics, %", "executed", "executed", "top"),
    ("length asked for, mm", "executed", "executed", "length_asked_mm"),
    ("length reached, mm", "executed", "executed", "length_reached_mm"),
    ("slid, grasped, lifted, %", "lifted", "lifted", "lifted"),
    ("verified per second, two cores", "test42", "", "verified_per_second"),
    ("joint diversity, rad", "test42", "", "joint_diversity"),
)
ABOUT = (
    "Rates in % of everything that was attempted; in brackets, 95 % intervals by bootstrap over objects, which are empty "
    "where all objects agree: by the binomial distribution all of 42 stand for 92 to 100 %, all of 14 for 77, all of 10 "
    "for 69. Robust: with a force margin of at least 1.5. Written by `python benchmarks/publish.py`; `make results "
    "RUN=NAME` makes a table again, `benchmarks/published_runs.yaml` lists the runs. The file that is linked below a table "
    "has every figure of its run."
)
ORDER = (*PAPER_SUCCESS, *HARD_SCENES, *NEW_SCENES)  # of scenes in tables
Row = dict[str, str]


@dataclass(frozen=True)
class Publish:
    """Run some of the published runs, and write their tables and the pages."""

    runs: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names in published_runs.yaml that are run and whose tables are written; "all" for every one. None: pages only."""
    folder: Path = Path("runs")
    """Folder of the runs' folders."""
    root: Path = ROOT
    """Folder that README.md and docs/ lie in."""
    only_write: bool = False
    """Do not run anything; the folders are there."""

    def run(self) -> None:
        """Run, collect, write."""
        listed = yaml.safe_load(RUNS.read_text(encoding="utf-8"))
        names = list(listed) if self.runs == ("all",) else list(self.runs)
        if unknown := [name for name in names if name not in listed]:
            raise SystemExit(f"no published run is called {unknown[0]!r}; expected some of {', '.join(listed)}, or all")
        for name in names:
            if not self.only_write:
                command = [*shlex.split(listed[name]["command"]), "--out", str(self.folder / name)]
                subprocess.run([sys.executable, "-m", "dexnudge", *command], check=True)
            collect(self.folder / name, name, self.root / "docs", rates_only="hand" in listed[name])
        data = {file.stem: read(file) for file in sorted((self.root / "docs" / "data").glob("*.csv"))}
        (self.root / "docs" / "results.md").write_text(page(listed, data, self.root / "docs"), encoding="utf-8")
        readme = self.root / "README.md"
        replace_between(readme, BEGIN, END, main_table(data, "docs/data"))
        replace_between(readme, HANDS_BEGIN, HANDS_END, hands_table(listed, data, "docs/data"))
        if ARM_BEGIN in readme.read_text(encoding="utf-8"):  # a README without these marks shows no arms
            replace_between(readme, ARM_BEGIN, ARM_END, arms_table(listed, data, "docs/data"))


def replace_between(file: Path, begin: str, end: str, text: str) -> None:
    """Put the text between two marks of a file."""
    before, rest = file.read_text(encoding="utf-8").split(begin)
    file.write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def collect(run: Path, name: str, docs: Path, *, rates_only: bool = False) -> None:
    """Copy the tables of a run's reports into docs/data, each row with what it was made with, and charts beside them.

    rates_only: neither rates by group nor charts.
    """
    for kind in KINDS:
        report = run / kind / "report.json"
        if not report.is_file():
            continue
        content = json.loads(report.read_text(encoding="utf-8"))
        config = content["config"]
        made = {
            "set": Path(config["objects"]).name,
            "draws_each": config["num"],
            "seed": config["seed"],
            "hand": config["hand"],
            "version": content["versions"]["dexnudge"],
            "machine": f"{content['machine']['processor']}, {content['machine']['cores']} cores",
        }
        stem = f"{name}-{kind}" if kind else name
        (docs / "data").mkdir(parents=True, exist_ok=True)
        (docs / "images").mkdir(parents=True, exist_ok=True)
        rows = [{**row, **made} for row in read(run / kind / "report.csv")]
        (docs / "data" / f"{stem}.csv").write_text(csv_text(rows), encoding="utf-8")
        if rates_only:
            continue
        for title, groups in content.get("sections", {}).items():
            if isinstance(groups, dict):  # rates by group, of all scenes and of each
                table = [
                    {"scenes": scene, "group": group, **_flat(rate), **made}
                    for scene, rates in groups.items()
                    for group, rate in rates.items()
                ]
                file = docs / "data" / f"{stem}-{title.lower().replace(' ', '-')}.csv"
                file.write_text(csv_text(table), encoding="utf-8")
        shown = kind or not any((run / other).is_dir() for other in KINDS if other)  # the page shows what a run is for
        for chart in ("rates", "calibration", "worlds") if shown else ():
            if (run / kind / f"{chart}.png").is_file():
                shutil.copyfile(run / kind / f"{chart}.png", docs / "images" / f"{stem}-{chart}.png")


def page(listed: dict[str, Any], data: dict[str, list[Row]], docs: Path) -> str:
    """The results page: the figures that matter, a short table of each run, its charts, and where the rest is."""
    parts = [
        "# Results",
        ABOUT,
        "## The figures that matter",
        figures_that_matter(data),
        main_table(data),
        "## Hands",
        hands_table(listed, data),
        "## Arms",
        arms_table(listed, data),
    ]
    for title in dict.fromkeys(run["title"] for run in listed.values() if run.get("page", "hand" not in run)):
        runs = {name: run for name, run in listed.items() if run["title"] == title}
        stems = {
            name: next((s for s in (f"{name}-lifted", f"{name}-executed", name) if s in data), "") for name in runs
        }
        found = [(data[stem], runs[name]) for name, stem in stems.items() if stem]
        if not found:
            continue
        stem = next(filter(None, stems.values()))
        files = {
            name: f"{stems[name]}-{run['groups']}" if "groups" in run else stems[name] for name, run in runs.items()
        }
        files = {name: file for name, file in files.items() if file in data}
        groups = [(runs[name]["label"], data[file]) for name, file in files.items() if "groups" in runs[name]]
        made = " ".join(made_with(data[file], file) for file in files.values())
        parts += [f"## {title}", groups_table(groups) if groups else run_table(found), made]
        kind = "worlds" if groups else "calibration" if stem.endswith("-executed") else "rates"
        chart = docs / "images" / f"{stem}-{kind}.png"
        parts += [f"![{title}](images/{chart.name})"] if chart.is_file() else []
    return "\n\n".join(parts) + "\n"


def figures_that_matter(data: dict[str, list[Row]]) -> str:
    """Ten figures of dexnudge by main scene."""
    scenes = tuple(PAPER_SUCCESS)
    rows = []
    for what, run, kind, column in FIGURES:
        found = {row["scene"]: row for row in _of(data, run, kind) if row["method"] == STEERED_NOISE}
        cells = [text(found.get(scene), column) for scene in scenes]
        rows += [[what, *cells]] if any(cells) else []
    return Table(["figure", *scenes], rows, labels=1).markdown()


def main_table(data: dict[str, list[Row]], link: str = "data") -> str:
    """Rates of the main methods beside the paper's."""
    played = {
        (column, row["scene"], row["method"]): row
        for run, kind, column in (("executed", "executed", "top"), ("lifted", "lifted", "lifted"))
        for row in _of(data, run, kind)
    }
    rows = []
    for scene, paper in PAPER_SUCCESS.items():
        for method in MAIN:
            for row in _of(data, "test42", ""):
                if (row["scene"], row["method"]) == (scene, method):
                    cells = [text(row, name) for name in ("single", "single_robust", "top", "top_robust")]
                    cells += [text(played.get((column, scene, method)), column) for column in ("top", "lifted")]
                    rows.append([scene, LABELS[method], *cells, paper if method == STEERED_NOISE else ""])
    header = ["scene", "method", "single draw", "robust", "top-ranked", "top-ranked robust", "pushed in physics"]
    table = Table([*header, "slid, grasped, lifted", "the paper, its own scenes"], rows).markdown()
    sources = (("Draws", "test42", ""), ("Pushed", "executed", "executed"), ("Lifted", "lifted", "lifted"))
    made = [
        f"{what}: {made_with(found, f'{run}-{kind}' if kind else run, link)}"
        for what, run, kind in sources
        if (found := _of(data, run, kind))
    ]
    return f"{table}\n\n% of everything attempted, 95 % intervals over objects. {' '.join(made)}"


def hands_table(listed: dict[str, Any], data: dict[str, list[Row]], link: str = "data") -> str:
    """Rates of each hand whose run names it: single draw, top-ranked, top-ranked executed, by main scene."""
    rows, made = [], []
    for name, run in listed.items():
        drawn, executed = (
            {row["scene"]: row for row in _of(data, name, kind) if row["method"] == run.get("method", STEERED_NOISE)}
            for kind in ("", "executed")
        )
        if "hand" not in run or not drawn:
            continue
        cells = [
            " · ".join(
                f"{100 * float(row[column]):.1f}" if row and row.get(column) else "–"
                for row, column in (
                    (drawn.get(scene), "single"),
                    (drawn.get(scene), "top"),
                    (executed.get(scene), "top"),
                )
            )
            for scene in PAPER_SUCCESS
        ]
        rows.append([run["hand"], *cells])
        made.append(f"{run['hand']}: {made_with(list(drawn.values()), name, link)}")
    if not rows:
        return "None."
    table = Table(["hand", *PAPER_SUCCESS], rows, labels=1).markdown()
    what = "Single draw · top-ranked · top-ranked executed in physics, % of everything attempted."
    return f"{table}\n\n{what} {' '.join(made)}"


def arms_table(listed: dict[str, Any], data: dict[str, list[Row]], link: str = "data") -> str:
    """What each arm whose run names it plans and executes, by scene."""
    rows, made = [], []
    for name, run in listed.items():
        for row in _of(data, name, "arm") if "arm" in run else []:
            used = "/".join(f"{float(row[f'{limit}_limit']):.2f}" if row[f"{limit}_limit"] else "–" for limit in LIMITS)
            deep = "/".join(f"{float(row[depth]):.1f}" if row[depth] else "–" for depth in DEPTHS)
            lifted = ", to a lift" if "--then-grasp" in run["command"] else ""
            rows.append([run["arm"], row["scene"] + lifted, *(text(row, column) for column in ARM_SHOWN), used, deep])
        if found := _of(data, name, "arm") if "arm" in run else []:
            reasons = {
                f"{row['scene']}: {key.removeprefix('outcomes.')} {value}"
                for row in found
                for key, value in row.items()
                if key.startswith("outcomes.") and value not in ("", "0")
            }
            without = f" Without success: {'; '.join(sorted(reasons))}." if reasons else ""
            made.append(f"{run['arm']}: {made_with(found, f'{name}-arm', link)}{without}")
    if not rows:
        return "None."
    header = ["arm", "scene", *ARM_SHOWN.values(), "limits used", "depth, mm"]
    what = (
        "% of everything attempted, 95 % intervals over objects. Limits used: largest share of position/velocity/"
        "acceleration/jerk. Depth: greatest along the plans in object/surroundings/itself."
    )
    return f"{Table(header, rows).markdown()}\n\n{what} {' '.join(made)}"


def run_table(found: list[tuple[list[Row], dict[str, Any]]]) -> str:
    """The columns of `SHOWN` that runs have, of the methods that their entries name, with their labels."""
    rows = [
        {**row, "label": run.get("label", "")}
        for data, run in found
        for row in sorted(data, key=lambda row: ORDER.index(row["scene"]) if row["scene"] in ORDER else len(ORDER))
        if row["method"] in run.get("methods", MAIN)
    ]
    columns = {name: header for name, header in SHOWN.items() if any(row.get(name) for row in rows)}
    if any("executed" in row for row in rows):
        columns.pop("single", None)  # the share of all that were executed; of one for each object it is `top`
    labels = ["left out"] if any(row["label"] for row in rows) else []
    table = [
        [
            *([row["label"]] if labels else []),
            row["scene"],
            LABELS.get(row["method"], row["method"]),
            *(text(row, each) for each in columns),
        ]
        for row in rows
    ]
    return Table([*labels, "scene", "method", *columns.values()], table, labels=2 + len(labels)).markdown()


def groups_table(runs: list[tuple[str, list[Row]]]) -> str:
    """Rates by group, a column for each scene, those of open loop behind those of feedback; runs by their labels."""
    scenes = list(dict.fromkeys(row["scenes"] for _, rows in runs for row in rows))
    table = []
    for label, rows in runs:
        cells = {(row["group"], row["scenes"]): row for row in rows}
        for group in dict.fromkeys(row["group"] for row in rows if not row["group"].endswith(OPEN_LOOP)):
            shown = []
            for scene in scenes:
                blind = cells.get((group + OPEN_LOOP, scene))
                both = f" · {100 * float(blind['rate']):.1f}" if blind else ""
                shown.append(text(cells.get((group, scene)), "rate") + both)
            table.append([label, group, *shown])
    return Table(["planned for", "setting: with feedback · open loop", *scenes], table, labels=2).markdown()


def made_with(rows: list[Row], stem: str, link: str = "data") -> str:
    """Objects, draws, seed, version and machine of a table, and where all of its figures are."""
    if not rows:
        return ""
    row = rows[0]
    return (
        f"{row['objects']} objects of `{row['set']}`, {row['draws_each']} draws each, seed {row['seed']}, dexnudge "
        f"{row['version']}, {row['machine']}: [{stem}.csv]({link}/{stem}.csv)."
    )


def text(row: Row | None, column: str) -> str:
    """A figure with its interval; empty where there is none."""
    if row is None or not row.get(column):
        return ""
    numbers = [float(row[name]) for name in (column, f"{column}_low", f"{column}_high") if row.get(name)]
    digits = NOT_PERCENT.get(column)
    if digits is None:
        value, *ends = (100 * number for number in numbers)
        return f"{value:.1f}" + (f" ({ends[0]:.0f}–{ends[1]:.0f})" if len(ends) == 2 else "")
    numbers = [round(number, digits) + 0.0 for number in numbers]  # no "-0"
    return f"{numbers[0]:.{digits}f}" + (
        f" ({numbers[1]:.{digits}f}–{numbers[2]:.{digits}f})" if len(numbers) == 3 else ""
    )


def read(file: Path) -> list[Row]:
    """The rows of a CSV file."""
    with file.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def _of(data: dict[str, list[Row]], run: str, kind: str) -> list[Row]:
    """Rows of a run; of a reproduction, those with the forearm."""
    rows = data.get(f"{run}-{kind}" if kind else run, [])
    return [row for row in rows if row.get("part", WITH_BASE) == WITH_BASE]


def _flat(group: dict[str, Any]) -> dict[str, Any]:
    rate = group["rate"]
    return {**group, "rate": rate["value"], "rate_low": rate["low"], "rate_high": rate["high"]}


if __name__ == "__main__":
    tyro.cli(Publish).run()
