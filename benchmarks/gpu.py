"""Seconds per stage of sampling on the CPU and on a CUDA device, by number of draws, what that makes a second, and memory.

Without a CUDA device its columns are left out, and the last line says so.
"""

import time
from dataclasses import dataclass

import torch
import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.errors import InputError
from dexnudge.geometry.devices import check_device
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, peak_memory_mb, versions
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.verification.verdicts import verify

STAGES = ("prepare", "draw", "project", "verify")
WARM_UP = 4  # draws that load kernels and weights, and are not counted


@dataclass(frozen=True)
class Benchmark:
    """Time each stage on each device; the same seed gives the same draws on both, up to rounding."""

    object: str = "phone"
    """Built-in object."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    nums: tuple[int, ...] = (32, 512, 4096)
    """Draws of one batch."""
    cuda: str = "cuda"
    """The CUDA device."""
    repeats: int = 1
    """Runs of each, with seeds 0, 1, 2 and so on."""

    def run(self) -> None:
        """Print machine, versions, and a line for each scene, number of draws and device."""
        console = stdout()
        unmeasured, devices = "", ["cpu"]
        try:
            devices.append(check_device(self.cuda))
        except InputError as error:
            unmeasured = f"unmeasured: no CUDA device ({error})"
        names = ", ".join(["cpu", *(torch.cuda.get_device_name(device) for device in devices[1:])])
        made_with = {**machine(names), **versions()}
        console.print("; ".join(f"{key} {value}" for key, value in made_with.items()), soft_wrap=True)
        shown = table("scene, draws, device", *STAGES, "verified", "verified/s", "device MB")
        hand = load_hand("shadow_lite")
        for device in devices:
            sampler = Sampler(hand, device=device)
            for name in self.scenes:
                sampler.sample(build_scene(name, self.object, seed=0), num=WARM_UP, seed=self.repeats)
                for num in self.nums:
                    shown.add_row(f"{name}, {num}, {device}", *self._line(sampler, name, num))
        console.print(shown)
        console.print("seconds of one batch; verified/s: with the scene prepared")
        console.print(f"peak memory of the process {peak_memory_mb():.0f} MB")
        if unmeasured:
            console.print(unmeasured, soft_wrap=True)

    def _line(self, sampler: Sampler, name: str, num: int) -> list[str]:
        device, seconds, verified = sampler.device, dict.fromkeys(STAGES, 0.0), 0
        if device != "cpu":
            torch.cuda.reset_peak_memory_stats(device)
        for seed in range(self.repeats):
            scene = build_scene(name, self.object, seed=0)  # anew: what is known about a scene is kept with it
            begun = time.perf_counter()
            problem = prepare(scene, device=device)
            seconds["prepare"] += time.perf_counter() - begun
            draws = sampler.draw(problem, num=num, seed=seed)
            begun = time.perf_counter()
            verified += int(verify(scene, sampler.hand, draws.q, device=device).success.sum())
            seconds["verify"] += time.perf_counter() - begun
            for stage, value in draws.seconds.items():
                seconds[stage] += value
        total = sum(seconds.values()) - seconds["prepare"]
        taken = "" if device == "cpu" else f"{torch.cuda.max_memory_allocated(device) / 1e6:.0f}"
        return [
            *(f"{seconds[stage] / self.repeats:.2f}" for stage in STAGES),
            f"{verified}/{num * self.repeats}",
            f"{verified / total:.1f}",
            taken,
        ]


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
