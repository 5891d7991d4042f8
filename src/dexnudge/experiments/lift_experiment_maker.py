"""One row of lifts: the draws of an experiment's row, made again, and the story of slide, grasp and lift with them."""

import time
from dataclasses import replace
from typing import Any

import numpy as np

from dexnudge.errors import DexnudgeError
from dexnudge.execution.slide_grasp_lift import Attempt, SlideGraspLift, SlideGraspLiftResult
from dexnudge.experiments.config import ExperimentConfig, Task, row_seed
from dexnudge.experiments.experiment_lines import UNVERIFIED
from dexnudge.experiments.lift_experiment_rows import LiftRow
from dexnudge.experiments.row_maker import DrawnTask, RowMaker
from dexnudge.sampling.sampler import Sampler
from dexnudge.simulation.model import scene_model


class LiftRowMaker:
    """Computes rows one after another, with the hand and the weights loaded once.

    The losses of the config are those of the draws; grasps are always drawn with their own.

    Args:
        config: of the experiment.
        tries: most tries of each story.

    Raises:
        CheckpointError: no weights for this hand, which grasps need whatever the method.
    """

    def __init__(self, config: ExperimentConfig, tries: int) -> None:
        self._config, self._tries = config, tries
        self._rows = RowMaker(config)
        self._grasps = Sampler.from_pretrained(self._rows.hand, weights=config.weights, device=config.device)

    def __call__(self, task: Task) -> LiftRow:
        """The row of a task. What cannot be read, placed or simulated gives a failed row."""
        row = failed_lift(self._config, task, UNVERIFIED)
        try:
            clock = time.perf_counter()
            drawn = self._rows.draw(task)
            seconds = {"draw": round(time.perf_counter() - clock, 4)}
            row = replace(row, drawn=len(drawn.draws.q), verified=drawn.draws.num_verified, seconds=seconds)
            if not row.verified:
                return row
            clock = time.perf_counter()
            story = self._play(drawn, seed=row.seed)
        except DexnudgeError as error:
            return failed_lift(self._config, task, f"{type(error).__name__}: {error}")
        return replace(
            row,
            status="played",
            reason="",
            tries=[_rounded(one) for one in story.attempts],
            ended=story.ended or "",
            simulated=0.0 if story.trace is None else round(float(story.trace.time[-1]), 3),
            seconds={**seconds, "play": round(time.perf_counter() - clock, 4)},
        )

    def _play(self, drawn: DrawnTask, *, seed: int) -> SlideGraspLiftResult:
        hand, scene = self._rows.hand, drawn.scene
        indices = np.flatnonzero(drawn.draws.verdicts.success)
        q = drawn.draws.q[indices].astype(np.float64)
        runner = SlideGraspLift(scene, scene_model(hand, scene), q, indices, self._grasps, seed=seed)
        return runner.run(self._tries)


def _rounded(one: Attempt) -> Attempt:
    figures: dict[str, Any] = {name: value for name, value in vars(one).items() if isinstance(value, float)}
    return replace(one, **{name: round(value, 6) for name, value in figures.items()})


def failed_lift(config: ExperimentConfig, task: Task, reason: str, *, drawn: int = 0) -> LiftRow:
    """A row that counts as one object that was not lifted."""
    return LiftRow(
        object=task.object,
        scene=task.scene,
        method=task.method,
        status="failed",
        reason=reason,
        seed=row_seed(config.seed, task),
        drawn=drawn,
    )
