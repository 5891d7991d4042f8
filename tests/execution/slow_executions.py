"""Executions of an experiment that take their time, to be killed in the middle: `slow_executions.py OUT`."""

import os
import sys
import time
from pathlib import Path

from dexnudge.evaluation.experiment_config import ExperimentConfig
from dexnudge.execution import experiment
from dexnudge.execution.experiment_rows import ExecutionRow


class SlowMaker:
    """Rows without physics; each names the process that made it."""

    def __init__(self, *_, **__):
        pass

    def __call__(self, task):
        time.sleep(0.02)
        if task.object == os.environ.get("KILLS_ITS_WORKER"):
            os._exit(9)
        return ExecutionRow(
            object=task.object,
            scene=task.scene,
            method=task.method,
            status="executed",
            seed=0,
            seconds={"process": float(os.getpid())},
        )


def main(out: Path) -> None:
    """Run it, or go on with it."""
    experiment.ExecutionRowMaker = SlowMaker
    out.mkdir(exist_ok=True)
    experiment.run_executions(ExperimentConfig(objects="builtin:test", scenes=("table", "shelf")), out, workers=2)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
