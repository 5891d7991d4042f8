"""Kept configurations per second of the data engine: the real `generate_dataset` in two processes, verification included."""

import cProfile
import pstats
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import CodeType

import numpy as np
import torch
import trimesh
import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.dataset.schema import BEHAVIOURS
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, versions
from dexnudge.objects.sets import resolve_object_set
from dexnudge.synthesis.acceptance import GraspVerifier, NonPrehensileVerifier
from dexnudge.synthesis.generate import GenerationConfig, generate_dataset
from dexnudge.synthesis.grasps import descend_to_grasp
from dexnudge.synthesis.nonprehensile import descend_to_contact
from dexnudge.synthesis.object_data import generate_object

STAGES: dict[str, tuple[CodeType, ...]] = {
    "grids": (build_scene_fields.__code__,),
    "descend": (descend_to_contact.__code__, descend_to_grasp.__code__),
    "prepare checks": (GraspVerifier.__init__.__code__, NonPrehensileVerifier.__init__.__code__),
    "verify": (GraspVerifier.__call__.__code__, NonPrehensileVerifier.__call__.__code__),
}


@dataclass(frozen=True)
class Benchmark:
    """Generate each kind of configuration alone into a temporary folder.

    Starting the processes, loading the hand in each and building every object's grids count; a run with one attempt for
    each object says how much that is.
    """

    objects: str = "builtin:test"
    """Set of objects."""
    num_objects: int = 4
    """How many of the set, from its start."""
    attempts: int = 256
    """Per object and kind."""
    workers: int = 2
    """Processes."""
    hand: str = "shadow_lite"
    """Hand."""
    seed: int = 0
    """Seed of the draws."""

    def run(self) -> None:
        """Print machine, versions, rates and yields by kind, counts by behaviour and the share of each stage."""
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        meshes = {entry.name: entry.load() for entry in resolve_object_set(self.objects)[: self.num_objects]}
        none = GenerationConfig(hand=self.hand, non_prehensile=0, grasps=0)
        kinds = {
            "non-prehensile": replace(none, non_prehensile=self.attempts),
            "grasps": replace(none, grasps=self.attempts),
        }
        console.print(f"{len(meshes)} objects, {self.attempts} attempts for each, {self.workers} processes")
        _, seconds = self._generate(meshes, replace(none, non_prehensile=1))
        console.print(f"of each run's wall-clock, starting and grids: {seconds:.1f} s")
        rates = table("kind", "attempted", "kept", "yield %", "wall s", "kept/s")
        behaviours = table("behaviour", "attempted", "kept", "rejected for")
        stages = table("kind, one object on one core", "CPU s", *(f"{stage} %" for stage in STAGES), "kept", "kept/s")
        for kind, config in kinds.items():
            counts, seconds = self._generate(meshes, config)
            of_kind = [name for name in BEHAVIOURS if name in counts and counts[name]["attempted"]]
            attempted, kept = (sum(int(counts[name][key]) for name in of_kind) for key in ("attempted", "kept"))
            share = f"{100 * kept / max(attempted, 1):.1f}"
            rates.add_row(kind, str(attempted), str(kept), share, f"{seconds:.1f}", f"{kept / seconds:.1f}")
            for name in of_kind:
                rejected = ", ".join(f"{reason} {count}" for reason, count in sorted(counts[name]["rejected"].items()))
                behaviours.add_row(name, str(counts[name]["attempted"]), str(counts[name]["kept"]), rejected)
            stages.add_row(kind, *self._shares(next(iter(meshes.values())), config))
        for shown in (rates, behaviours, stages):
            console.print(shown)

    def _generate(self, meshes: dict[str, trimesh.Trimesh], config: GenerationConfig) -> tuple[dict, float]:
        """(counts by behaviour, wall-clock seconds) of a dataset in a temporary folder."""
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "objects"
            source.mkdir()
            for name, mesh in meshes.items():
                mesh.export(source / f"{name}.obj")
            start = time.perf_counter()
            manifest = generate_dataset(
                str(source), Path(folder) / "dataset", config, seed=self.seed, workers=self.workers
            )
            return manifest.counts, time.perf_counter() - start

    def _shares(self, mesh: trimesh.Trimesh, config: GenerationConfig) -> list[str]:
        """CPU seconds of one object when everything is loaded, the share of each stage, what was kept, and its rate."""
        torch.set_num_threads(1)
        hand = load_hand(self.hand)

        def generate(attempts: GenerationConfig) -> int:
            rows, *_ = generate_object(
                hand,
                mesh,
                non_prehensile=attempts.non_prehensile,
                grasps=attempts.grasps,
                generator=np.random.default_rng(self.seed),
                seed=self.seed,
            )
            return len(rows)

        generate(replace(config, non_prehensile=min(config.non_prehensile, 8), grasps=min(config.grasps, 8)))
        profile = cProfile.Profile(time.process_time)
        start = time.process_time()
        kept = profile.runcall(generate, config)
        seconds = time.process_time() - start
        inside = {key[1:]: entry[3] for key, entry in pstats.Stats(profile).stats.items()}  # type: ignore[attr-defined]
        shares = [
            sum(inside.get((code.co_firstlineno, code.co_name), 0.0) for code in codes) / seconds
            for codes in STAGES.values()
        ]
        return [f"{seconds:.1f}", *(f"{100 * share:.0f}" for share in shares), str(kept), f"{kept / seconds:.1f}"]


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
