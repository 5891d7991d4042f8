"""Energy and gradient of a batch of hands: the fused kernel against plain torch, and against what the machine allows."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
import tyro
from floor import CHAINS, FUSED, ITEMS, LOOKUP, TRANSFORM, multiply_add
from torch_energy import TorchEnergy

from dexnudge.cli.arguments import stdout, table
from dexnudge.energies.descent import HandDescent, HandPose
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_points import surface_points
from dexnudge.geometry.warp_runtime import wp
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, versions
from dexnudge.objects.builtin import builtin_object
from dexnudge.synthesis.acceptance import resting_scene
from dexnudge.synthesis.nonprehensile import NonPrehensileConfig, sample_pre_contact
from dexnudge.synthesis.object_data import TARGET_SPACING, at_rest

COPIED = 64 * 1024**2  # float32 values: larger than the caches
VALUES = 8 * 4  # bytes of the eight corners


@dataclass(frozen=True)
class Benchmark:
    """Time both sides on the same hands in one run, and compare what they find."""

    object: str = "phone"
    """Built-in object, on a table."""
    hands: int = 256
    """Hands of a batch."""
    steps: int = 40
    """Steps of the descent before the hands are taken: they are then near the object and the table."""
    repeats: int = 15
    """Evaluations of the kernel; torch does a third of them."""
    threads: int = 2
    """Threads of either side."""
    seed: int = 0
    """Of the hands."""

    def run(self) -> None:
        """Print machine, versions, times, their ratio, the difference and the floor."""
        torch.set_num_threads(self.threads)
        console = stdout()
        facts = {**machine(), **versions(), "threads": self.threads}
        console.print("; ".join(f"{key} {value}" for key, value in facts.items()), soft_wrap=True)
        energy, pose, plain = self._sides()
        tangent = torch.zeros(self.hands, 6 + energy.hand.num_joints, requires_grad=True)

        def torch_side() -> tuple[torch.Tensor, torch.Tensor]:
            terms = plain(pose, tangent, energy.contact_weight)
            return terms.detach(), torch.autograd.grad(terms.sum(), tangent)[0]

        ours = _milliseconds(lambda: energy(pose), self.repeats)
        theirs = _milliseconds(torch_side, max(3, self.repeats // 3))
        shown = table(
            "256 hands" if self.hands == 256 else f"{self.hands} hands", "min ms", "median ms", "processor ms"
        )
        for name, times in (("fused kernel", ours), ("torch, pytorch_kinematics, autograd", theirs)):
            shown.add_row(
                name, *(f"{value:.2f}" for value in (min(times[0]), statistics.median(times[0]), min(times[1])))
            )
        console.print(shown)
        ratios = [min(theirs[0]) / min(ours[0]), statistics.median(theirs[0]) / statistics.median(ours[0])]
        ratios.append(min(theirs[1]) / min(ours[1]))
        console.print("ratio {:.0f} (min), {:.0f} (median), {:.0f} (processor time of all threads)".format(*ratios))
        terms, gradient = torch_side()
        console.print(
            f"largest difference over the largest value: energies {_difference(energy.energy[:, :4], terms):.1e}, "
            f"gradient {_difference(energy.gradient, gradient):.1e}"
        )
        self._floor(console.print, plain, min(ours[1]) / self.threads)

    def _sides(self) -> tuple[HandEnergy, HandPose, TorchEnergy]:
        hand, mesh = load_hand("shadow_lite"), at_rest(builtin_object(self.object))
        fields = build_scene_fields(mesh, resting_scene(mesh).environment_mesh)
        surface = surface_points(mesh, spacing=TARGET_SPACING)
        generator = np.random.default_rng(self.seed)
        start = sample_pre_contact(hand, surface, centre_of_mass(mesh), count=self.hands, generator=generator)
        config = NonPrehensileConfig()
        weights = replace(config.weights, target=0.0)
        energy = HandEnergy(hand, fields, self.hands, weights)
        tips = [hand.link_names.index(link) for link in hand.fingertip_links]
        energy.contact_weight[:, tips] = torch.as_tensor(start.touches, dtype=torch.float32)
        descent, pose = HandDescent(hand, self.hands, steps=config.steps), start.pose
        for _ in range(self.steps):
            energy(pose)
            pose = descent.step(pose, energy.gradient)
        return energy, pose, TorchEnergy(hand, fields, weights)

    def _floor(self, show: Callable[[str], None], plain: TorchEnergy, ours: float) -> None:
        points = self.hands * len(plain.points)
        operations, size = points * (TRANSFORM + 2 * LOOKUP), points * 2 * VALUES
        values, sums = np.ones(COPIED, dtype=np.float32), wp.zeros(ITEMS, dtype=float, device="cpu")
        copied = np.empty_like(values)
        copying = min(_milliseconds(lambda: np.copyto(copied, values), 5)[1]) * 1e-3
        inputs = [0.999, FUSED, sums]
        adding = min(_milliseconds(lambda: wp.launch(multiply_add, ITEMS, inputs, device="cpu"), 5)[1]) * 1e-3
        bandwidth = self.threads * 2 * values.nbytes / copying
        rate = self.threads * 2 * ITEMS * CHAINS * FUSED / adding
        times = operations / rate * 1e3, size / bandwidth * 1e3
        show(
            f"floor of looking every point up once in object and environment: {operations / 1e6:.0f} M operations at "
            f"{rate / 1e9:.0f} G/s {times[0]:.2f} ms; {size / 1e6:.0f} MB at {bandwidth / 1e9:.0f} GB/s {times[1]:.2f} ms "
            f"(rates of one thread, measured, times {self.threads}); the kernel takes "
            f"{ours / max(times):.1f} times the larger one (processor time per thread), with "
            "contacts, the object's and the table's points in the links, and the hand against itself"
        )


def _milliseconds(call: Callable[[], object], repeats: int) -> tuple[list[float], list[float]]:
    """(wall, processor) times: the second says what a busy machine hides."""
    call()
    wall, processor = [], []
    for _ in range(repeats):
        start, start_processor = time.perf_counter(), time.process_time()
        call()
        wall.append(1e3 * (time.perf_counter() - start))
        processor.append(1e3 * (time.process_time() - start_processor))
    return wall, processor


def _difference(one: torch.Tensor, other: torch.Tensor) -> float:
    return float((one - other).abs().max() / other.abs().max())


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
