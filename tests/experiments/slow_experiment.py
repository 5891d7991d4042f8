"""An experiment that takes its time, to be killed in the middle: `slow_experiment.py OUT`."""

import os
import sys
import time
from pathlib import Path

from dexnudge.experiments import experiments
from dexnudge.experiments.config import ExperimentConfig, row_seed
from dexnudge.experiments.rows import Row


class SlowRowMaker:
    """Rows without sampling; each names the process that made it."""

    def __init__(self, config):
        self.config = config

    def __call__(self, task):
        time.sleep(0.02)
        return Row(
            object=task.object,
            scene=task.scene,
            method=task.method,
            status="sampled",
            num=1,
            seed=row_seed(self.config.seed, task),
            success=[True],
            seconds={"process": float(os.getpid())},
        )


def main(out: Path) -> None:
    """Run it, or go on with it."""
    experiments.RowMaker = SlowRowMaker
    config = ExperimentConfig(objects="builtin:test", scenes=("table", "layers", "shelf"))
    experiments.run_experiment(config, out, workers=2)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
