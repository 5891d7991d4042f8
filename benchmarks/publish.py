"""Writes the tables of runs into docs/results.md and the README, from their reports alone."""

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.method_names import method_name
from dexnudge.experiments.paper_tables import FULL, TABLE_1
from dexnudge.experiments.reproduction_parts import MAIN, STEERED_NOISE, WITH_BASE

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
Rates = dict[tuple[str, str], dict[str, float]]  # (scene, method) -> rate with its interval
PLOT = re.compile(r"\]\(plots/([^)]+)\)")


@dataclass(frozen=True)
class Publish:
    """Write the published tables and copy the plots that they show."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders that `dexnudge reproduce` or `dexnudge evaluate` wrote; the README's table is that of the first."""
    executed: tuple[Path, ...] = ()
    """Folders that `dexnudge evaluate --execute` wrote: their texts come next, rates of the first into the README."""
    effects: tuple[Path, ...] = ()
    """Folders that `dexnudge evaluate --execute` wrote with something left out, and one without: one table of them all."""
    lifted: tuple[Path, ...] = ()
    """Folders that `dexnudge evaluate --then-grasp` wrote: their texts come last, all their rates into the README."""
    root: Path = ROOT
    """Folder that README.md and docs/ lie in."""

    def run(self) -> None:
        """Write both files and the plots beside them."""
        report = json.loads((self.runs[0] / "report.json").read_text(encoding="utf-8"))
        readme = self.root / "README.md"
        before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
        after = rest.split(END)[1]
        texts = [self._with_plots(run) for run in self.runs]
        executed: Rates = {}
        lifted: Rates = {}
        if self.executed:
            texts += [self._with_calibration(run) for run in self.executed]
            executed = rates(self.executed[0] / "executed.json", "top")
        if self.effects:
            texts.append(effects_table(self.effects))
        for run in self.lifted:
            texts.append((run / "lifted.md").read_text(encoding="utf-8"))
            lifted |= rates(run / "lifted.json", "lifted")
        if len(texts) > 1:
            texts.insert(0, contents(texts))
        (self.root / "docs" / "results.md").write_text("\n".join(texts), encoding="utf-8")
        readme.write_text(f"{before}{BEGIN}\n{readme_table(report, executed, lifted)}\n{END}{after}", encoding="utf-8")

    def _with_calibration(self, run: Path) -> str:
        """What the run's executions say, their chart copied to docs/images under a name that holds the run's."""
        name = f"{run.resolve().name}-calibration.svg"
        shutil.copyfile(run / "calibration.svg", self.root / "docs" / "images" / name)
        return (run / "executed.md").read_text(encoding="utf-8").replace("](calibration.svg)", f"](images/{name})")

    def _with_plots(self, run: Path) -> str:
        """The run's report, its plots copied to docs/images under names that hold the run's."""
        text = (run / "report.md").read_text(encoding="utf-8")
        images = self.root / "docs" / "images"
        images.mkdir(parents=True, exist_ok=True)
        name = run.resolve().name
        for plot in PLOT.findall(text):
            shutil.copyfile(run / "plots" / plot, images / f"{name}-{plot}")
        return PLOT.sub(rf"](images/{name}-\1)", text)


def rates(path: Path, name: str) -> Rates:
    """That rate of each line of a report."""
    lines = json.loads(path.read_text(encoding="utf-8"))["lines"]
    return {(line["scene"], line["method"]): line[name] for line in lines}


def contents(texts: list[str]) -> str:
    """What the page holds: a link to each text's heading."""
    titles = [text.splitlines()[0].removeprefix("# ") for text in texts]
    anchors = [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]
    again = [anchors[:place].count(anchor) for place, anchor in enumerate(anchors)]
    links = [f"#{anchor}-{count}" if count else f"#{anchor}" for anchor, count in zip(anchors, again, strict=True)]
    return "".join(f"- [{title}]({link})\n" for title, link in zip(titles, links, strict=True))


def effects_table(runs: tuple[Path, ...]) -> str:
    """How many single draws are verified and how often the best-ranked one succeeds in physics, run by run."""
    reports = [json.loads((run / "executed.json").read_text(encoding="utf-8")) for run in runs]
    first = reports[0]["config"]
    for config in (report["config"] for report in reports):
        if any(config[name] != first[name] for name in ("objects", "max_objects", "num", "seed")):
            raise SystemExit("the runs of --effects differ in objects, draws or seed; expected the same of all")
    rows = []
    for run, report in zip(runs, reports, strict=True):
        single = rates(run / "report.json", "single")
        left_out = "".join(f", weight {name} {value:g}" for name, value in (report["config"]["losses"] or {}).items())
        for line in report["lines"]:
            row = [method_name(line["method"]) + left_out, line["scene"], line["objects"]]
            verified = percent(single[line["scene"], line["method"]])
            rows.append([*row, verified, line["unverified"], percent(line["top"])])
    header = ["what", "scene", "objects", "single draw verified", "without verified", "top-ranked in physics"]
    return (
        "# Executed in physics: with parts left out\n\n"
        "Each run draws anew without that part. Top-ranked: share of all objects whose best verified draw succeeds in "
        f"physics. In %; in brackets, 95 % intervals over objects. {Path(first['objects']).name}, {first['num']} draws for "
        f"each object and scene, seed {first['seed']}, dexnudge {reports[0]['versions']['dexnudge']}.\n\n"
        f"{markdown_table(header, rows, names=2)}\n"
    )


def readme_table(report: dict[str, Any], executed: Rates, lifted: Rates) -> str:
    """Rates [%] with 95 % intervals over objects, beside the paper's."""
    config = report["config"]
    header = ["scene", "method", "single draw", "single, robust", "top-ranked", "robust"]
    header += ["pushed in physics", "slid, grasped, lifted", "the paper, its own scenes"]
    rows = [f"| {' | '.join(header)} |", "|---|---|---:|---:|---:|---:|---:|---:|---:|"]
    order = [(scene, method) for scene in config["scenes"] for method in MAIN]
    shown = [line for line in report["lines"] if line.get("part", WITH_BASE) == WITH_BASE]  # evaluate has no parts
    lines = {(line["scene"], line["method"]): line for line in shown}
    for key in order:
        if key in lines:
            line = lines[key]
            cells = [percent(line[name]) for name in ("single", "single_robust", "top", "top_robust")]
            cells += [percent(played[key]) if key in played else "" for played in (executed, lifted)]
            paper = (
                f"{TABLE_1[line['scene']][FULL]}"
                if line["method"] == STEERED_NOISE and line["scene"] in TABLE_1
                else ""
            )
            rows.append(f"| {line['scene']} | {method_name(line['method'])} | {' | '.join(cells)} | {paper} |")
    objects = max(line["objects"] for line in shown)
    note = (
        f"\n% of everything attempted, 95 % intervals over objects: {objects} objects of `{Path(config['objects']).name}`, "
        f"{config['num']} draws each, seed {config['seed']}. [All methods and reasons for rejection](docs/results.md)."
    )
    return "\n".join(rows) + "\n" + note


def percent(rate: dict[str, float]) -> str:
    """A rate with its interval."""
    return f"{100 * rate['value']:.1f} ({100 * rate['low']:.0f}–{100 * rate['high']:.0f})"


if __name__ == "__main__":
    tyro.cli(Publish).run()
