"""What an evaluation of 1,000 objects costs on 1, 10 and 100 machines, reckoned from stages that are measured here.

Measured, in processor time of one thread, which other work on this machine hardly changes: how long a worker takes to start
(interpreter, hand, weights, kernels), a trial in each scene, and the driver for a record. Reckoned: workers start at once,
then take trials as they come; the driver writes one record after another. Ray's own start and messages are not counted.
"""

import os
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.experiments.config import ExperimentConfig, trial_keys
from dexnudge.experiments.records import RecordWriter
from dexnudge.experiments.run import TrialRunner
from dexnudge.experiments.sampling_records import SamplingRecord
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.jobs.processes import use_one_thread
from dexnudge.jobs.provenance import machine, versions

PAGE = Path(__file__).parents[1] / "docs" / "concepts" / "machines.md"
BEGIN, END = "<!-- machines:begin -->", "<!-- machines:end -->"
WRITTEN = 200  # records by which the driver is timed
START = (
    "from dexnudge.jobs.processes import use_one_thread; import torch; use_one_thread();"
    "from dexnudge.experiments.trial import TrialSampler; from dexnudge.experiments.config import *;"
    "config = ExperimentConfig(objects='builtin:test', max_objects=1, scenes=('table',), num=1);"
    "TrialSampler(config).draw(trial_keys(config)[0])"
)


@dataclass(frozen=True)
class Benchmark:
    """Measure, reckon and print; with --write, also into the page."""

    objects: int = 1000
    """Objects of the evaluation that is reckoned."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    num: int = 32
    """Draws for each object and scene."""
    nodes: tuple[int, ...] = (1, 10, 100)
    """Machines."""
    cores: int = 16
    """Cores of each: a worker on each core."""
    measured: int = 3
    """Objects that are run here, of the built-in test set."""
    speed_up: int = 0
    """Also run so many objects on Ray here, with one worker and with two; only a quiet machine has cores for two."""
    write: bool = False
    """Put the table into docs/concepts/machines.md."""

    def run(self) -> None:
        """Print machine, versions, what was measured, and a line for each number of machines."""
        use_one_thread()
        subprocess.run([sys.executable, "-c", START], check=True)
        children = os.times()
        start = children.children_user + children.children_system
        trials = {}
        for scene in self.scenes:
            config = ExperimentConfig(objects="builtin:test", max_objects=self.measured, scenes=(scene,), num=self.num)
            keys, run = trial_keys(config), SamplingTrial().start(config)
            run(keys[0])  # loads kernels
            begun = time.process_time()
            records = [run(key) for key in keys]
            trials[scene] = (time.process_time() - begun) / len(records)
        driver = _seconds_per_record(records[0])
        rows = [self._reckoned(nodes, start, trials, driver) for nodes in self.nodes]
        found = (
            f"One worker starts in {start:.1f} s; a trial of {self.num} draws takes "
            f"{', '.join(f'{seconds:.2f} s ({scene})' for scene, seconds in trials.items())} on one core; the driver takes "
            f"{1e3 * driver:.1f} ms for a record."
        )
        made = "; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items())
        console = stdout()
        console.print(made, soft_wrap=True)
        console.print(found, soft_wrap=True)
        shown = table(*HEADER)
        for row in rows:
            shown.add_row(*row)
        console.print(shown)
        if self.speed_up:
            one, two = (self._seconds_on_ray(workers) for workers in (1, 2))
            console.print(f"on Ray, once all workers have started: 1 worker {one:.1f} s, 2 workers {two:.1f} s")
            console.print(f"speed-up of two workers: {one / two:.2f}")
        if self.write:
            marks = [HEADER, ["---:"] * len(HEADER), *rows]
            lines = "\n".join(f"| {' | '.join(line)} |" for line in marks)
            before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
            text = f"{self.objects:,} objects in {len(self.scenes)} scenes. {found}\n\n{lines}\n\nMade with {made}."
            PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")

    def _seconds_on_ray(self, workers: int) -> float:
        """Seconds for a record once all workers have started, times the records of the evaluation."""
        config = ExperimentConfig(objects="builtin:test", max_objects=self.speed_up, scenes=self.scenes, num=self.num)
        times: list[float] = []
        with tempfile.TemporaryDirectory() as folder:
            runner = TrialRunner([SamplingTrial()], config, Path(folder))
            list(runner.run(workers=workers, engine="ray", on_record=lambda *_: times.append(time.perf_counter())))
        return (times[-1] - times[workers - 1]) / (len(times) - workers) * len(times)

    def _reckoned(self, nodes: int, start: float, trials: dict[str, float], driver: float) -> list[str]:
        cores, count = nodes * self.cores, self.objects * len(trials)
        work = self.objects * sum(trials.values())
        # The last trial begins when all others are under way or done.
        wall = start + max(work / cores + max(trials.values()), count * driver)
        return [
            str(nodes),
            f"{cores:,}",
            f"{wall:,.0f}",
            f"{wall * cores / 3600:,.1f}",
            f"{100 * work / (wall * cores):.0f}",
            f"{count * self.num / wall:,.0f}",
        ]


HEADER = ["machines", "cores", "wall clock [s]", "core hours", "at work [%]", "draws per second"]


def _seconds_per_record(record: SamplingRecord) -> float:
    with tempfile.TemporaryDirectory() as folder, closing(RecordWriter(Path(folder))) as writer:
        begun = time.process_time()
        for number in range(WRITTEN):
            writer.append(replace(record, object=str(number)))
        return (time.process_time() - begun) / WRITTEN


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
