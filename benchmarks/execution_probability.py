"""Fit and check the probability that a verified configuration holds in physics (`results.probability`).

draw, then execute, then fit; each goes on where it was stopped.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro

from dexnudge.errors import DexnudgeError
from dexnudge.execution.executor import Executor
from dexnudge.hands.registry import load_hand
from dexnudge.objects.sets import resolve_object_set
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.uncertainty import Uncertainty
from dexnudge.simulation.model import scene_model
from dexnudge.verification.verdicts import verify

WORLDS = Uncertainty(friction=(0.5, 1.25), friction_environment=(0.75, 1.5), mass=(0.5, 2.0))
"""Scenes other than the default ones, in which configurations are verified, planned and executed; half stay as they are."""
DRAWS, EXECUTED = "q.npy", "executed.jsonl"


@dataclass(frozen=True, kw_only=True)
class Draw:
    """Draw and verify configurations for a set of objects; only those that are verified are kept."""

    objects: str
    """Set of objects."""
    out: Path
    """Folder of the runs."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    hand: str = "shadow_lite"
    """Hand."""
    num: int = 12
    """Draws for each object and scene."""

    def run(self) -> None:
        """Draw what is missing."""
        torch.set_num_threads(1)
        hand = load_hand(self.hand)
        sampler = Sampler.from_pretrained(hand)
        for entry in resolve_object_set(self.objects):
            for family in self.scenes:
                folder = self.out / f"{entry.name}-{family}"
                if (folder / DRAWS).exists():
                    continue
                seed = zlib.crc32(folder.name.encode())
                try:
                    build_scene(family, entry.load(), seed=seed).save(folder)
                    samples = sampler.sample(Scene.load(folder), num=self.num, seed=seed)
                except DexnudgeError as error:
                    print(f"{folder.name}: {error}", flush=True)
                    continue
                np.save(folder / DRAWS, samples.verified.q)
                print(f"{folder.name}: {samples.num_verified} of {self.num} verified", flush=True)


@dataclass(frozen=True, kw_only=True)
class Execute:
    """Execute some verified configurations of each scene, at random, in it and in one of other frictions and mass."""

    out: Path
    """Folder of the runs."""
    hand: str = "shadow_lite"
    """Hand."""
    each: int = 4
    """Configurations for each scene and world."""

    def run(self) -> None:
        """Execute what is missing."""
        torch.set_num_threads(1)
        hand, done = load_hand(self.hand), {(row["scene"], row["world"]) for row in executed(self.out)}
        folders = [path.parent for path in self.out.glob(f"*/{DRAWS}")]
        for folder in sorted(folders, key=lambda path: zlib.crc32(path.name.encode())):
            scene, q = Scene.load(folder), np.load(folder / DRAWS).astype(np.float64)
            seed = zlib.crc32(folder.name.encode())
            for world, physics in enumerate(({}, replace(WORLDS, seed=seed, worlds=2).sampled(scene)[0][0])):
                if (folder.name, world) in done or not len(q):
                    continue
                there = replace(scene, **physics)
                verified = np.flatnonzero(verify(there, hand, q).success)
                chosen = np.random.default_rng([seed, world]).permutation(verified)[: self.each]
                executor = Executor(there, scene_model(hand, there)) if len(chosen) else None
                rows = []
                for index in chosen.tolist():
                    assert executor is not None
                    verdict = executor(q[index]).verdict
                    row = {"scene": folder.name, "world": world, "draw": index, "physics": physics}
                    rows.append(row | {"outcome": verdict.outcome.value, "reached": verdict.length_reached})
                with (self.out / EXECUTED).open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(row) + "\n" for row in rows)
                print(folder.name, world, [row["outcome"] for row in rows], flush=True)


def executed(out: Path) -> list[dict[str, Any]]:
    """Return the executions so far, a row each."""
    path = out / EXECUTED
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


if __name__ == "__main__":
    commands = Annotated[Draw, tyro.conf.subcommand("draw")] | Annotated[Execute, tyro.conf.subcommand("execute")]
    tyro.cli(commands, description=__doc__).run()
