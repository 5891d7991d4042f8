"""Trains variants of the model that differ in one choice, with equal steps, and compares what their draws are worth.

Everything is read back from the run folders: stop it, start it again, and it goes on; the table holds what is there so far.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from safetensors import safe_open

from dexnudge.cli.arguments import stdout
from dexnudge.diffusion.checkpoint import STATE_NAME, read_provenance
from dexnudge.diffusion.config import Architecture, TrainingConfig
from dexnudge.diffusion.objective import REPORTED_LEVELS
from dexnudge.diffusion.training import train
from dexnudge.errors import DexnudgeError
from dexnudge.hands.registry import load_hand
from dexnudge.objects.sets import ObjectEntry, resolve_object_set
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene

VARIANTS: dict[str, dict[str, Any]] = {
    "digits, v": {},
    "single, v": {"token_layout": "single"},
    "scalars, v": {"token_layout": "scalars"},
    "digits, x0": {"prediction_type": "sample"},
    "digits, epsilon": {"prediction_type": "epsilon"},
}
DRAWS_NAME, TABLE_NAME = "draws.jsonl", "comparison.md"
ROBUST = 1.5  # force margin of a robust draw
NOTE = """

Draws: verified (robust) share [%] and number. Errors: root mean square of the clean estimate on held-out objects, by share
of the noise steps.
"""


@dataclass(frozen=True)
class Comparison:
    """One training run for each variant, then the same draws from each of them."""

    out: Path
    """Folder of the runs and the table."""
    data: Path = Path("datasets/shadow_lite")
    """Dataset folder."""
    variants: tuple[str, ...] = tuple(VARIANTS)
    """Which of them."""
    steps: int = 2500
    """Optimiser steps of each run."""
    groups: int = 16
    """Objects in a batch, 16 configurations each."""
    width: int = 128
    """Channels of the transformer."""
    depth: int = 6
    """Blocks of the transformer."""
    objects: Annotated[tuple[str, ...], tyro.conf.arg(metavar="SET")] = ("builtin:test",)
    """Sets of objects to draw on."""
    per_set: int = 6
    """Objects of each set, spread evenly over it."""
    scenes: tuple[str, ...] = ("table", "shelf")
    """Scene families."""
    methods: tuple[str, ...] = ("steered_noise", "unguided_projection")
    """Sampling methods."""
    num: int = 16
    """Draws for each object, scene and method."""
    seed: int = field(default=1)
    """Seed of scenes and draws."""

    def run(self) -> None:
        """Train, draw, write the table after each object."""
        for name in self.variants:
            train(self.data, self.out / folder_name(name), self.config(name), progress=False)
        self.write_table()
        for source in self.sources():
            self.draw_on(source)
            self.write_table()

    def config(self, name: str) -> TrainingConfig:
        """What all variants share, and what this one changes."""
        return TrainingConfig(
            steps=self.steps,
            groups=self.groups,
            warmup_steps=max(1, self.steps // 20),
            grasp_fraction=0.2,
            min_direction_margin=ROBUST,
            num_threads=1,
            validate_every=self.steps,
            checkpoint_every=100,
            architecture=Architecture(width=self.width, depth=self.depth, **VARIANTS[name]),
        )

    def sources(self) -> Iterator[ObjectEntry]:
        """Objects of all sets in turn, so that a stopped comparison has seen some of each."""
        picked = []
        for text in self.objects:
            sources = resolve_object_set(text)
            picked.append(sources[:: max(1, len(sources) // self.per_set)][: self.per_set])
        for row in range(self.per_set):
            yield from (sources[row] for sources in picked if row < len(sources))

    def draw_on(self, source: ObjectEntry) -> None:
        """Append one line for each variant, scene and method that has none for this object yet."""
        todo = [name for name in self.variants if not self.has_drawn_on(name, source.name)]
        if not todo:
            return
        hand = load_hand("shadow_lite")
        lines: dict[str, list[dict[str, Any]]] = {name: [] for name in todo}
        for scene_name in self.scenes:
            try:
                scene = build_scene(scene_name, source.load(), seed=self.seed)
                problem = prepare(scene)
            except DexnudgeError as error:
                failed = {"object": source.name, "scene": scene_name, "num": self.num, "verified": 0, "robust": 0}
                for name in todo:
                    lines[name] += [{**failed, "method": method, "error": str(error)} for method in self.methods]
                continue
            for name in todo:
                weights = self.out / folder_name(name) / "model"
                sampler = Sampler(hand, weights=weights)
                for method in self.methods:
                    draws = sampler.sample(scene, num=self.num, seed=self.seed, method=method, problem=problem)
                    robust = int(draws.verdicts.robust.sum())
                    line = {"object": source.name, "scene": scene_name, "num": self.num, "robust": robust}
                    lines[name].append({**line, "verified": draws.num_verified, "method": method})
        for name, rows in lines.items():  # an object appears whole or not at all
            with (self.out / folder_name(name) / DRAWS_NAME).open("a", encoding="utf-8") as file:
                file.write("".join(json.dumps(row) + "\n" for row in rows))

    def has_drawn_on(self, name: str, object_name: str) -> bool:
        """Whether the variant's file holds the object."""
        return any(row["object"] == object_name for row in drawn_rows(self.out / folder_name(name)))

    def write_table(self) -> None:
        """`comparison.md` in the out folder, and the same on the console."""
        names = [name for name in self.variants if (self.out / folder_name(name) / "model").is_dir()]
        text = comparison_table({name: self.out / folder_name(name) for name in names})
        (self.out / TABLE_NAME).write_text(text, encoding="utf-8")
        stdout().print(text, soft_wrap=True, markup=False)


def folder_name(variant: str) -> str:
    """Name of the variant's run folder."""
    return variant.replace(", ", "-")


def drawn_rows(folder: Path) -> list[dict[str, Any]]:
    """What was drawn with the model of this run, one row for each object, scene and method."""
    path = folder / DRAWS_NAME
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def comparison_table(folders: dict[str, Path]) -> str:
    """One row for each run: validation errors, minutes, and the share of draws that are verified (robust)."""
    rows = {name: drawn_rows(folder) for name, folder in folders.items()}
    groups = sorted({(row["scene"], row["method"]) for found in rows.values() for row in found})
    levels = "".join(f" error at {level:g} [mm / deg] |" for level in REPORTED_LEVELS)
    heads = "".join(f" {scene}, {method} |" for scene, method in groups)
    lines = [
        f"| variant | steps | min |{levels}{heads}",
        "|---|---:|---:|" + "---:|" * (len(REPORTED_LEVELS) + len(groups)),
    ]
    for name, folder in folders.items():
        provenance = read_provenance(folder / "model")
        validation: Any = provenance["validation"]
        errors = "".join(
            f" {validation[f'validation/translation_mm_at_{level}']:.1f} / "
            f"{validation[f'validation/joints_deg_at_{level}']:.1f} |"
            for level in REPORTED_LEVELS
        )
        cells = "".join(
            f" {_rate([row for row in rows[name] if (row['scene'], row['method']) == key])} |" for key in groups
        )
        lines.append(f"| {name} | {provenance['step']} | {_minutes(folder):.0f} |{errors}{cells}")
    return "\n".join(lines) + NOTE


def _rate(rows: list[dict[str, Any]]) -> str:
    num, verified, robust = (sum(row[key] for row in rows) for key in ("num", "verified", "robust"))
    return f"{100 * verified / num:.0f} ({100 * robust / num:.0f}), n {num}" if num else "-"


def _minutes(folder: Path) -> float:
    with safe_open(folder / STATE_NAME, framework="pt") as file:
        return float(json.loads(file.metadata()["training"])["minutes"])


if __name__ == "__main__":
    tyro.cli(Comparison).run()
