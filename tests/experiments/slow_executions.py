"""Rows of physics that take their time, to be killed in the middle: `slow_executions.py OUT executed|lifted`."""

import os
import sys
import time
from pathlib import Path

from dexnudge.experiments import execution_experiment as experiment
from dexnudge.experiments import lift_experiment
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.experiment_rows import ExecutionRow
from dexnudge.experiments.lift_experiment_rows import LiftRow


class SlowMaker:
    """Rows without physics; each names the process that made it."""

    def __init__(self, *_, **__):
        pass

    def __call__(self, task):
        time.sleep(0.02)
        if task.object == os.environ.get("KILLS_ITS_WORKER"):
            os._exit(9)
        return self.row(task, seed=0, seconds={"process": float(os.getpid())})

    def row(self, task, **common):
        """An executed row."""
        return ExecutionRow(object=task.object, scene=task.scene, method=task.method, status="executed", **common)


class SlowLifts(SlowMaker):
    """The same for lifts."""

    def row(self, task, **common):
        """A row of a story that was played."""
        return LiftRow(object=task.object, scene=task.scene, method=task.method, status="played", **common)


def main(out: Path, kind: str) -> None:
    """Run it, or go on with it."""
    experiment.ExecutionRowMaker, lift_experiment.LiftRowMaker = SlowMaker, SlowLifts
    out.mkdir(exist_ok=True)
    run = {"executed": experiment.run_executions, "lifted": lift_experiment.run_lifts}[kind]
    run(ExperimentConfig(objects="builtin:test", scenes=("table", "shelf")), out, workers=2)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
