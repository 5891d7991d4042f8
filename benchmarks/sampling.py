"""Seconds per stage of one sampling run, by scene and method, what that makes a second, and how soon the first comes."""

import math
import time
from dataclasses import dataclass

import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, peak_memory_mb, versions
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene

STAGES = ("prepare", "draw", "project", "verify", "rank")


@dataclass(frozen=True)
class Benchmark:
    """Time sampling on this machine; the first run of each scene warms up and is not counted."""

    object: str = "phone"
    """Built-in object."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    methods: tuple[str, ...] = ("steered_noise", "random_start_projection")
    """Methods to compare."""
    num: int = 32
    """Draws of one run."""
    repeats: int = 3
    """Runs, with seeds 0, 1, 2 and so on."""

    def run(self) -> None:
        """Print machine, versions and one line for each scene and method."""
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        hand = load_hand("shadow_lite")
        sampler = Sampler(hand)
        mesh = builtin_object(self.object)
        shown = table("scene, method", *STAGES, "total", "verified", "verified/s", "prepared")
        first = table("first verified of", *STAGES, "least", "most")
        for scene_name in self.scenes:

            def scene(name: str = scene_name) -> Scene:
                return build_scene(name, mesh, seed=0)  # anew: what is known about a scene is kept with it

            for method in self.methods:
                sampler.sample(scene(), num=self.num, seed=self.repeats, method=method)
                runs = [sampler.sample(scene(), num=self.num, seed=seed, method=method) for seed in range(self.repeats)]
                seconds = {stage: sum(run.seconds[stage] for run in runs) for stage in STAGES}
                firsts = [self._first(sampler, scene(), seed=seed, method=method) for seed in range(self.repeats)]
                least = min(firsts, key=lambda each: each["total"])
                most = max(each["total"] for each in firsts)
                first.add_row(
                    f"{scene_name}, {method}",
                    *(f"{least[stage]:.2f}" for stage in STAGES),
                    f"{least['total']:.2f} s",
                    f"{most:.2f} s",
                )
                verified, total = sum(run.num_verified for run in runs), sum(seconds.values())
                shown.add_row(
                    f"{scene_name}, {method}",
                    *(f"{seconds[stage] / self.repeats:.2f}" for stage in STAGES),
                    f"{total / self.repeats:.2f}",
                    f"{verified}/{self.num * self.repeats}",
                    f"{verified / total:.1f}",
                    f"{verified / (total - seconds['prepare']):.1f}",
                )
        console.print(shown)
        console.print("verified/s: with preparation; prepared: without")
        console.print(first)
        console.print("from the scene to its first verified configuration; stages: of the fastest of the runs")
        console.print(f"peak memory {peak_memory_mb():.0f} MB")

    @staticmethod
    def _first(sampler: Sampler, scene: Scene, *, seed: int, method: str) -> dict[str, float]:
        """Seconds from a scene to its first verified configuration, by stage and in all."""
        begin = time.perf_counter()
        found = sampler.sample(scene, verified=1, seed=seed, method=method)
        total = time.perf_counter() - begin if found.num_verified else math.inf
        return {**found.seconds, "total": total}


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
