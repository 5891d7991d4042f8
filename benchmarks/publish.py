"""Writes the tables of an experiment into docs/results.md and the README, from its reports alone."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
README_METHODS = {"ours": "dexnudge", "random_start_projection": "random start + projection"}
PAPER = {"table": 73.2, "layers": 78.0, "shelf": 63.4}  # [%] Table I, one outcome per object, 41 objects


@dataclass(frozen=True)
class Publish:
    """Write the published tables."""

    experiments: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders that `dexnudge evaluate` wrote; the README's table is that of the first."""

    def run(self) -> None:
        """Write both files."""
        report = json.loads((self.experiments[0] / "report.json").read_text(encoding="utf-8"))
        reports = [(folder / "report.md").read_text(encoding="utf-8") for folder in self.experiments]
        (ROOT / "docs" / "results.md").write_text("\n".join(reports), encoding="utf-8")
        readme = ROOT / "README.md"
        text = readme.read_text(encoding="utf-8")
        before, rest = text.split(BEGIN)
        after = rest.split(END)[1]
        readme.write_text(f"{before}{BEGIN}\n{readme_table(report)}\n{END}{after}", encoding="utf-8")


def readme_table(report: dict[str, Any]) -> str:
    """Rates [%] with 95 % intervals over objects, beside the paper's."""
    config = report["config"]
    rows = [
        "| scene | method | single draw | single, robust | top-ranked | top-ranked, robust | the paper, its own scenes |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    order = [(scene, method) for scene in config["scenes"] for method in README_METHODS]
    lines = {(line["scene"], line["method"]): line for line in report["lines"]}
    for key in order:
        if key in lines:
            line = lines[key]
            cells = [percent(line[name]) for name in ("single", "single_robust", "top", "top_robust")]
            paper = f"{PAPER[line['scene']]}" if line["method"] == "ours" and line["scene"] in PAPER else ""
            rows.append(f"| {line['scene']} | {README_METHODS[line['method']]} | {' | '.join(cells)} | {paper} |")
    objects = max(line["objects"] for line in report["lines"])
    note = (
        f"\n% of everything attempted, 95 % intervals over objects: {objects} objects of `{config['objects']}`, "
        f"{config['num']} draws each, seed {config['seed']}. [All methods and reasons for rejection](docs/results.md)."
    )
    return "\n".join(rows) + "\n" + note


def percent(rate: dict[str, float]) -> str:
    """A rate with its interval."""
    return f"{100 * rate['value']:.1f} ({100 * rate['low']:.0f}–{100 * rate['high']:.0f})"


if __name__ == "__main__":
    tyro.cli(Publish).run()
