"""What a new hand gains by starting from another hand's weights: equal data and steps, loss and success side by side.

Writes docs/data/transfer.csv and the table in docs/concepts/measurements.md. A stopped run goes on; what is there already
is not run again.
"""

import csv
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from dexnudge.diffusion.checkpoint import MODEL_FOLDER, read_provenance
from dexnudge.experiments.tables import Table, csv_text
from dexnudge.sampling.sampler import SHIPPED_WEIGHTS

ROOT = Path(__file__).parents[1]
SETTINGS = "--groups 32 --grasp-fraction 0.1 --min-direction-margin 1.5 --scale-jitter 0 --token-layout single"
WARM_UP = 100  # steps
SCENES = ("table", "layers", "shelf")
BEGIN, END = "<!-- transfer:begin -->", "<!-- transfer:end -->"
ERRORS = {"loss": "loss", "translation_mm": "translation_mm_at_0.25", "joints_deg": "joints_deg_at_0.25"}


@dataclass(frozen=True)
class Transfer:
    """Train from nothing and from another hand's weights, with as many steps each, and evaluate both."""

    data: Path
    """Dataset folder of the new hand."""
    folder: Path = Path("runs/transfer")
    """Folder of the runs."""
    start_from: Path = SHIPPED_WEIGHTS / "shadow_lite"
    """Model folder of the other hand; must have the same architecture."""
    steps: tuple[int, ...] = (500, 2000)
    """Optimiser steps."""
    objects: str = "builtin:test"
    """Set of objects to evaluate on."""
    max_objects: int = 8
    """So many of it."""
    num: int = 16
    """Draws for each object and scene."""
    root: Path = ROOT
    """Folder that docs/ lies in."""

    def run(self) -> None:
        """Train, evaluate, write."""
        starts = {"nothing": (), self.start_from.name: ("--start-from", str(self.start_from))}
        rows = [self._row(start, given, steps) for steps in self.steps for start, given in starts.items()]
        (self.root / "docs" / "data" / "transfer.csv").write_text(csv_text(rows), encoding="utf-8")
        page = self.root / "docs" / "concepts" / "measurements.md"
        before, rest = page.read_text(encoding="utf-8").split(BEGIN)
        page.write_text(f"{before}{BEGIN}\n{_text(rows)}\n{END}{rest.split(END)[1]}", encoding="utf-8")

    def _row(self, start: str, given: tuple[str, ...], steps: int) -> dict[str, Any]:
        run = self.folder / f"{start}-{steps}"
        model, report = run / "training" / MODEL_FOLDER, run / "evaluation" / "report.csv"
        if not model.is_dir() or read_provenance(model)["step"] < steps:
            options = f"--steps {steps} --warmup-steps {WARM_UP} {SETTINGS}".split()
            _dexnudge("train", "--data", str(self.data), "--out", str(run / "training"), *options, *given)
        made = read_provenance(model)
        hand = json.loads((model / "config.json").read_text(encoding="utf-8"))["model"]["hand"]
        if not report.is_file():
            options = f"--max-objects {self.max_objects} --num {self.num} --scenes".split()
            drawn = ["--objects", self.objects, *options, *SCENES, "--out", str(report.parent)]
            _dexnudge("evaluate", "--hand", hand, "--weights", str(model), *drawn)
        found = {row["scene"]: row for row in csv.DictReader(report.read_text(encoding="utf-8").splitlines())}
        rates = {f"{scene}{end}": found[scene][f"single{end}"] for scene in SCENES for end in ("", "_low", "_high")}
        errors = {name: round(made["validation"][f"validation/{key}"], 4) for name, key in ERRORS.items()}
        about = {"objects_trained": made["objects"], "rows_trained": made["configurations"], "set": self.objects}
        machine = {"version": made["made_with"]["dexnudge"], "machine": made["made_with"]["processor"]}
        draws = {"objects": found["table"]["objects"], "draws": found["table"]["draws"]}
        return {"hand": hand, "start": start, "steps": steps, **errors, **rates, **about, **draws, **machine}


def _text(rows: list[dict[str, Any]]) -> str:
    shown = [
        [row["start"], row["steps"], row["loss"], *(f"{100 * float(row[scene]):.1f}" for scene in SCENES)]
        for row in rows
    ]
    table = Table(["starts from", "steps", "loss on held-out objects", *SCENES], shown, labels=1).markdown()
    row = rows[0]
    return (
        f"{table}\n\n{row['hand']}, {row['rows_trained']:,} rows of {row['objects_trained']} objects; single draws, "
        f"% verified of {row['draws']} a scene on {row['objects']} objects of `{row['set']}`; dexnudge {row['version']}, "
        f"{row['machine']}: [transfer.csv](../data/transfer.csv)."
    )


def _dexnudge(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "dexnudge", *arguments], check=True)


if __name__ == "__main__":
    tyro.cli(Transfer).run()
