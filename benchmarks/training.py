"""Training steps per second in float32 and bfloat16, on one thread and more."""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.dataset.loading import Dataset, load_dataset
from dexnudge.diffusion.config import Architecture, TrainingConfig
from dexnudge.diffusion.distributed import Precision, has_bfloat16
from dexnudge.diffusion.training_run import TrainingRun
from dexnudge.jobs.provenance import machine, versions


@dataclass(frozen=True)
class Benchmark:
    """Time whole steps: batch, forward, backward, optimiser, averaged weights."""

    data: Path = Path("datasets/shadow_lite")
    """Dataset folder."""
    threads: tuple[int, ...] = (1, 2)
    """Numbers of threads."""
    groups: int = 16
    """Objects in a batch, 16 configurations each."""
    width: int = 128
    """Channels of the transformer."""
    depth: int = 6
    """Blocks of the transformer."""
    steps: int = 10
    """Steps that are timed, after two that warm up."""

    def run(self) -> None:
        """Print machine, versions and one line for each precision and number of threads."""
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        dataset = load_dataset(self.data)
        known: tuple[Precision, ...] = ("float32", "bfloat16")
        precisions = [p for p in known if p == "float32" or has_bfloat16(torch.device("cpu"))]
        shown = table("threads, precision", "ms/step", "CPU ms/step", "steps/s", "rows/s", "CPU time against float32")
        for threads in self.threads:
            torch.set_num_threads(threads)
            timed = {precision: self.seconds(dataset, precision) for precision in precisions}
            for precision, (wall, processor) in timed.items():
                shown.add_row(
                    f"{threads}, {precision}",
                    f"{1000 * wall:.0f}",
                    f"{1000 * processor:.0f}",
                    f"{1 / wall:.2f}",
                    f"{16 * self.groups / wall:.0f}",
                    f"{processor / timed['float32'][1]:.2f}",
                )
        console.print(shown)
        if len(precisions) == 1:
            console.print("this processor has no bfloat16")

    def seconds(self, dataset: Dataset, precision: Precision) -> tuple[float, float]:
        """Wall-clock and processor time of one step; the second one does not count what other programs take."""
        config = TrainingConfig(
            steps=1_000_000,
            groups=self.groups,
            validate_every=1_000_000,
            checkpoint_every=1_000_000,
            precision=precision,
            architecture=Architecture(width=self.width, depth=self.depth),
        )
        with tempfile.TemporaryDirectory() as folder:
            run = TrainingRun(dataset, Path(folder), config)
            for _ in range(2):
                run.advance(None)
            wall, processor = time.perf_counter(), time.process_time()
            for _ in range(self.steps):
                run.advance(None)
            return (time.perf_counter() - wall) / self.steps, (time.process_time() - processor) / self.steps


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
