"""What one draw costs on one thread, stage by stage, and the least that its arithmetic would cost on this machine."""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro
import warp

from dexnudge.cli.arguments import stdout, table
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, versions
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene

CHAINS, FUSED, ITEMS = 64, 4096, 500  # independent sums, multiply-adds in each, launches: neither memory nor latency
TRANSFORM, LOOKUP = 18, 60  # operations to move a point, and to find a distance and its gradient between eight corners
PAGE = Path(__file__).parents[1] / "docs" / "concepts" / "performance.md"
BEGIN, END = "<!-- floor:begin -->", "<!-- floor:end -->"
FIELDS = 2  # object and environment, in which every point of the hand is looked up at least once
SQUARE = 1024  # rows of the matrices whose product measures the rate of multiply-adds in torch
KERNELS = {
    "energies": "energy",
    "contacts": "contacts",
    "solve_balance": "balance",
    "advance": "steps",
    "kinematics": "steps",
    "reduce_gradient": "steps",
}
COLUMNS = (
    "scene",
    "draws",
    "hand-steps",
    "network",
    *dict.fromkeys(KERNELS.values()),
    "torch",
    "sum",
    "floor",
    "ratio",
)


Sums = warp.types.vector(length=CHAINS, dtype=warp.float32)


@warp.kernel(enable_backward=False)
def multiply_add(factor: float, count: int, out: warp.array(dtype=float)):
    """Nothing but multiply-adds."""
    i = warp.tid()
    sums = Sums(1.0)
    step = Sums(factor)
    for _ in range(count):
        sums = sums * factor + step
    out[i] = warp.dot(sums, sums)


@dataclass(frozen=True)
class Benchmark:
    """Count and time what a draw and its projection do on one thread; the first run of each scene warms up."""

    object: str = "phone"
    """Built-in object."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    nums: tuple[int, ...] = (32, 512)
    """Draws of a call."""
    repeats: int = 3
    """Calls, with seeds 0, 1, 2 and so on."""
    write: bool = False
    """Put the table into the page of the documentation."""

    def run(self) -> None:
        """Print machine, versions and a row for each scene and size of a call, in microseconds of processor time a draw."""
        torch.set_num_threads(1)
        console = stdout()
        made = "; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items())
        console.print(made, soft_wrap=True)
        sampler, shown, rows = Sampler(load_hand("shadow_lite")), table(*COLUMNS), []
        rates = _kernel_rate(), _torch_rate()
        for scene in self.scenes:
            problem = prepare(build_scene(scene, builtin_object(self.object), seed=0))
            for num in self.nums:
                rows.append([scene, str(num), *self._row(sampler, problem, num, *rates)])
                shown.add_row(*rows[-1])
        console.print(shown)
        console.print(f"microseconds of one thread a draw; rates {rates[0] / 1e9:.0f} and {rates[1] / 1e9:.0f} G/s")
        if self.write:
            lines = [COLUMNS, ["---", *["---:"] * (len(COLUMNS) - 1)], *rows]
            text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
            before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
            PAGE.write_text(
                f"{before}{BEGIN}\n{text}\n\nMade with {made}.\n{END}{rest.split(END)[1]}", encoding="utf-8"
            )

    def _row(
        self, sampler: Sampler, problem: SamplingProblem, num: int, kernel_rate: float, torch_rate: float
    ) -> list[str]:
        sampler.draw(problem, num=num, seed=self.repeats)
        with _watched() as (seconds, hands):
            begin = time.process_time()
            for seed in range(self.repeats):
                sampler.draw(problem, num=num, seed=seed)
            total = time.process_time() - begin
        draws = num * self.repeats
        steps, forwards = hands["energies"] / draws, hands["network"] / draws
        parameters = sum(each.numel() for name, each in sampler.prior.network.named_parameters() if "blocks" in name)
        points = len(sampler.hand.sparse_points.points)
        floor = steps * points * (TRANSFORM + FIELDS * LOOKUP) / kernel_rate + forwards * 2 * parameters / torch_rate
        stages = Counter({"network": seconds["network"]})
        for kernel, stage in KERNELS.items():
            stages[stage] += seconds[kernel]
        stages["torch"] = total - sum(stages.values())
        microseconds = [1e6 * stages[stage] / draws for stage in COLUMNS[3:-3]]
        total = sum(microseconds)
        return [
            f"{steps:.1f}",
            *(f"{each:.0f}" for each in microseconds),
            f"{total:.0f}",
            f"{1e6 * floor:.0f}",
            f"{total / (1e6 * floor):.1f}",
        ]


@contextmanager
def _watched() -> Iterator[tuple[Counter[str], Counter[str]]]:
    """Count processor time [s] and hands of each kernel and of the network meanwhile."""
    seconds: Counter[str] = Counter()
    hands: Counter[str] = Counter()
    launch, replay, predict = warp.launch, warp.Launch.launch, DiffusionPrior.predict_clean

    def count(name: str, num: int, begin: float) -> None:
        seconds[name] += time.process_time() - begin
        hands[name] += num

    def launched(kernel: Any, dim: Any, *args: Any, **options: Any) -> Any:
        begin = time.process_time()
        made = launch(kernel, dim, *args, **options)
        if not options.get("record_cmd"):
            count(kernel.key, dim if isinstance(dim, int) else dim[0], begin)
        return made

    def replayed(self: Any, *args: Any) -> None:
        begin = time.process_time()
        replay(self, *args)
        count(self.kernel.key, self.bounds.shape[0], begin)

    def predicted(self: DiffusionPrior, x_t: torch.Tensor, *args: Any, **options: Any) -> torch.Tensor:
        begin = time.process_time()
        made = predict(self, x_t, *args, **options)
        count("network", len(x_t), begin)
        return made

    try:
        warp.launch, warp.Launch.launch, DiffusionPrior.predict_clean = launched, replayed, predicted
        yield seconds, hands
    finally:
        warp.launch, warp.Launch.launch, DiffusionPrior.predict_clean = launch, replay, predict


def _kernel_rate() -> float:
    """Operations a second of one thread of a kernel that only multiplies and adds."""
    sums = warp.zeros(ITEMS, dtype=float, device="cpu")
    seconds = []
    for _ in range(6):
        begin = time.process_time()
        warp.launch(multiply_add, ITEMS, [0.999, FUSED, sums], device="cpu")
        seconds.append(time.process_time() - begin)
    return 2 * ITEMS * CHAINS * FUSED / min(seconds)


def _torch_rate() -> float:
    """Operations a second of one thread in the product of two matrices."""
    one, seconds = torch.ones(SQUARE, SQUARE), []
    for _ in range(6):
        begin = time.process_time()
        one @ one
        seconds.append(time.process_time() - begin)
    return 2 * SQUARE**3 / min(seconds)


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
