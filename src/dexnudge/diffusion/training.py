"""Training the denoiser: resumable, killable at any moment, the same weights whether or not it was interrupted."""

import math
import signal
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from dexnudge.dataset.loading import load_dataset
from dexnudge.diffusion.compute import joined_processes
from dexnudge.diffusion.model_card import write_model_card
from dexnudge.diffusion.training_config import TrainingConfig
from dexnudge.diffusion.training_run import MODEL_FOLDER, TrainingLog, TrainingRun


@dataclass(frozen=True, kw_only=True)
class TrainingResult:
    """model_folder: the averaged weights so far; step of steps done; finished: False if it was interrupted.

    is_main: whether this process is the one that validates and reports; there is one in each run.
    """

    model_folder: Path
    step: int
    minutes: float
    finished: bool
    validation: dict[str, float]
    is_main: bool


def train(
    dataset_folder: Path | str,
    out_folder: Path | str,
    config: TrainingConfig,
    *,
    progress: bool = True,
    stop_at_step: int | None = None,
    made_with: dict[str, Any] | None = None,
) -> TrainingResult:
    """Train on a dataset folder; continue if `out_folder` holds an unfinished run of the same settings and data.

    SIGTERM and SIGINT end the run after the current step with everything saved. `stop_at_step` does the same at a step.
    made_with: versions and machine, for the model's card, which is written at the end.
    Started by torchrun, the processes share every batch; `out_folder` must be the same for all of them.
    Raises DatasetError for unusable data, CheckpointError for a run that cannot be continued, InputError for a device or
    precision that is not there, DexnudgeError when the loss stops being finite.
    """
    out_folder = Path(out_folder)
    out_folder.mkdir(parents=True, exist_ok=True)
    if config.num_threads is not None:
        torch.set_num_threads(config.num_threads)
    columns = (
        TextColumn("training"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("loss {task.fields[loss]:.4f}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with joined_processes(config.device) as processes:
        run = TrainingRun(load_dataset(dataset_folder), out_folder, config, processes)
        run.provenance |= {"data": Path(dataset_folder).resolve().name, "made_with": made_with or {}}
        with (
            _stop_signals() as stop,
            closing(TrainingLog(out_folder, step=run.step)) if processes.is_main else nullcontext() as log,
            Progress(*columns, disable=not (progress and processes.is_main)) as bar,
        ):
            task = bar.add_task("training", total=config.steps, completed=run.step, loss=math.nan)
            while not run.finished:
                if processes.largest(float(stop.is_set())) or run.step == stop_at_step:
                    run.save()
                    break
                run.advance(log)
                bar.update(task, completed=run.step, loss=run.mean_loss)
        if processes.is_main and run.step > 0:
            write_model_card(out_folder)
    return TrainingResult(
        model_folder=out_folder / MODEL_FOLDER,
        step=run.step,
        minutes=run.minutes,
        finished=run.finished,
        validation=run.validation,
        is_main=processes.is_main,
    )


@contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """An event that SIGTERM and SIGINT set; the former handlers come back afterwards."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # signals reach the main thread only
        return

    def handle(_signum: int, _frame: FrameType | None) -> None:
        stop.set()

    former = {number: signal.signal(number, handle) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
