"""Training the denoiser: planned, resumable, killable at any moment, with the same weights whether interrupted or not."""

import importlib.util
import json
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from itertools import takewhile
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from rich.progress import TextColumn

from dexnudge.dataset.loading import Dataset, load_datasets
from dexnudge.diffusion.checkpoint import (
    LOG_NAME,
    MODEL_FOLDER,
    STATE_NAME,
    load_model,
    load_state,
    read_provenance,
    read_state_header,
    save_model,
    save_state,
)
from dexnudge.diffusion.config import TrainingConfig
from dexnudge.diffusion.distributed import Processes, joined_processes
from dexnudge.diffusion.model_card import write_model_card
from dexnudge.diffusion.training_run import TrainingRun
from dexnudge.errors import CheckpointError, OutputError, quote, writing
from dexnudge.jobs.atomic_files import remove_leftovers
from dexnudge.jobs.progress import progress

TENSORBOARD = "tensorboard"  # folder of charts
LOSS_SMOOTHING = 0.98  # of the loss that is shown
WARM_UP_STEPS, MEASURED_STEPS = 3, 20  # of a plan: the first steps allocate memory and are slower
MEASURED_SHARE = 0.05  # of the time limit that measuring may take
TO_GO_ON = "expected a folder with free space; make room, and the same command goes on from the last saved state"
RESERVE = 0.03  # share of the time limit that a plan leaves for saving, and for a machine that slows down


@dataclass(frozen=True, kw_only=True)
class TrainingPlan:
    """How many steps fit into a time limit, from the measured time of a step with its share of the validations."""

    max_minutes: float
    seconds_per_step: float
    steps: int

    def __str__(self) -> str:
        return (
            f"{self.steps} steps of {1e3 * self.seconds_per_step:.3g} ms fit into {self.max_minutes:g} min; "
            "the learning rate falls over them"
        )


def plan_training(dataset: Dataset, config: TrainingConfig, processes: Processes | None = None) -> TrainingPlan:
    """Measure some steps and return how many fit into `config.max_minutes`, so that the schedule ends at the limit.

    Nothing is kept of the measured steps: a run of as many steps has the same weights with a time limit or without.
    """
    assert config.max_minutes is not None
    processes = processes or Processes()
    limit = 60.0 * config.max_minutes
    begun = time.perf_counter()
    run = TrainingRun(dataset, config, processes)
    for _ in range(WARM_UP_STEPS):
        run.advance()
    started = time.perf_counter()
    for _ in range(MEASURED_STEPS):
        run.advance()
        # All processes leave the loop at the same step.
        if processes.largest(time.perf_counter() - begun) > MEASURED_SHARE * limit:
            break
    per_step = (time.perf_counter() - started) / (run.step - WARM_UP_STEPS)
    validated = time.perf_counter()
    if processes.is_main:
        run.validate()
    per_step = processes.largest(per_step + (time.perf_counter() - validated) / config.validate_every)
    left = (1.0 - RESERVE) * limit - processes.largest(time.perf_counter() - begun)
    return TrainingPlan(
        max_minutes=config.max_minutes, seconds_per_step=per_step, steps=max(1, math.floor(left / per_step))
    )


class TrainingLog:
    """Appends to `train.jsonl` and to `tensorboard/`, until `close`.

    Lines from steps after `step`, written before a crash and about to be repeated, are cut off; no other line is
    written again, so a kill loses none.
    """

    def __init__(self, folder: Path, *, step: int) -> None:
        self._path = folder / LOG_NAME
        with writing(self._path, TO_GO_ON):
            if self._path.is_file():
                with self._path.open("rb") as file:
                    kept = sum(map(len, takewhile(lambda line: _is_of_step_until(line, step), file)))
                os.truncate(self._path, kept)
            self._file = self._path.open("a", encoding="utf-8")
        self._writer = None
        if importlib.util.find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(folder / TENSORBOARD), purge_step=step + 1)

    def write(self, step: int, values: dict[str, float]) -> None:
        """Append one event; the file is flushed so that it can be followed."""
        line = json.dumps({"step": step, **{name: round(value, 6) for name, value in values.items()}}) + "\n"
        with writing(self._path, TO_GO_ON):
            self._file.write(line)
            self._file.flush()
            if self._writer is not None:
                for name, value in values.items():
                    self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close both."""
        with writing(self._path, TO_GO_ON):
            self._file.close()
            if self._writer is not None:
                self._writer.close()


def _is_of_step_until(line: bytes, step: int) -> bool:
    try:
        return line.endswith(b"\n") and bool(json.loads(line)["step"] <= step)
    except (ValueError, KeyError, TypeError):  # a line that a kill cut off
        return False


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
    dataset: Path | str | Sequence[Path | str],
    out_folder: Path | str,
    config: TrainingConfig,
    *,
    stop_at_step: int | None = None,
    made_with: dict[str, Any] | None = None,
    on_plan: Callable[[TrainingPlan], None] | None = None,
) -> TrainingResult:
    """Train on a dataset folder, or on several as one; continue an unfinished run of the same settings and data.

    With `config.max_minutes` and without `config.steps` the number of steps is planned first. SIGTERM and SIGINT end the
    run before the current step, or after it, with everything saved. Started by torchrun, the processes share every batch.

    stop_at_step: ends the run there as a signal does; made_with: versions and machine, for the model's card, which is
    written at the end; on_plan: told the plan, in the main process.

    Raises:
        DatasetError: unusable data.
        CheckpointError: a run that cannot be continued.
        InputError: a device or precision that is not there.
        OutputError: the folder cannot be written.
        DexnudgeError: the loss stopped being finite.
    """
    out_folder = Path(out_folder)
    with writing(out_folder, TO_GO_ON):
        out_folder.mkdir(parents=True, exist_ok=True)
    there = {path.name for path in out_folder.iterdir() if not path.name.startswith(".")}
    if there and not there & {MODEL_FOLDER, LOG_NAME, STATE_NAME, TENSORBOARD}:
        raise OutputError(
            f"{out_folder} holds {quote(min(there))} and no training; expected a new folder, or one of a run to go on with; "
            "choose another `out`"
        )
    if config.num_threads is not None:
        torch.set_num_threads(config.num_threads)
    folders = [dataset] if isinstance(dataset, str | Path) else dataset
    with joined_processes(config.device) as processes:
        data = load_datasets(folders)
        if processes.is_main:
            remove_leftovers(out_folder)
        config = _planned(data, out_folder, config, processes, on_plan)
        run = TrainingRun(data, config, processes)
        provenance = {
            "data": " and ".join(Path(folder).resolve().name for folder in folders),
            "dataset": run.dataset_id,
            "objects": len(run.training_objects),
            "held_out_objects": [data.object_names[k] for k in run.held_out_objects],
            "configurations": len(data),
            "config": {**asdict(config), **run.settings},
            "made_with": made_with or {},
        }
        validation = _train(run, out_folder, provenance, stop_at_step)
        if processes.is_main and run.step > 0:
            write_model_card(out_folder)
    return TrainingResult(
        model_folder=out_folder / MODEL_FOLDER,
        step=run.step,
        minutes=run.minutes,
        finished=run.progress >= 1.0,
        validation=validation,
        is_main=processes.is_main,
    )


def _planned(
    dataset: Dataset,
    folder: Path,
    config: TrainingConfig,
    processes: Processes,
    on_plan: Callable[[TrainingPlan], None] | None,
) -> TrainingConfig:
    """The config with the steps that its time limit allows, or those that an unfinished run was planned with."""
    if config.steps is not None or config.max_minutes is None:
        return config
    if (folder / STATE_NAME).is_file():
        return replace(config, steps=read_state_header(folder)["config"]["steps"])
    plan = plan_training(dataset, config, processes)
    if on_plan is not None and processes.is_main:
        on_plan(plan)
    return replace(config, steps=plan.steps)


def _train(run: TrainingRun, folder: Path, provenance: dict[str, Any], stop_at_step: int | None) -> dict[str, float]:
    """Take the steps that are left, with whatever is due after each; return the figures last found."""
    config, processes = run.config, run.processes
    state = load_state(folder, run.identity)
    validation: dict[str, float] = {}
    mean_loss = math.nan
    if state is not None:
        tensors, header = state
        run.restore(tensors, step=header["step"], minutes=header["minutes"])
        validation, mean_loss = header.get("validation", {}), header.get("loss", math.nan)
    logged = (run.step, run.minutes)

    def save() -> None:
        """Training state first, then the model that is shipped."""
        if processes.is_main and run.step > 0:
            reached = {"step": run.step, "validation": validation}
            header = {**reached, "loss": mean_loss, "minutes": run.minutes, **run.identity}
            save_state(folder, run.state(), header)
            made = {**provenance, **reached}
            save_model(folder / MODEL_FOLDER, run.model_config, run.average, run.normaliser, provenance=made)

    def spent(since: float) -> None:
        run.minutes += processes.largest(time.perf_counter() - since) / 60.0

    with (
        closing(TrainingLog(folder, step=run.step)) if processes.is_main else nullcontext() as log,
        progress(TextColumn("loss {task.fields[loss]:.4f}")) as bars,
        _stop_signals() as stop,
    ):
        bar = bars.add_task("training", total=run.num_steps, completed=run.step, loss=math.nan, visible=log is not None)
        done = run.progress >= 1.0
        if done and processes.is_main and not _is_model_of(folder / MODEL_FOLDER, run.step):
            save()  # the process was killed between the last state and its model, or the model was damaged since
        while not done:
            if processes.largest(float(stop.is_set())) or run.step == stop_at_step:
                save()
                break
            started = time.perf_counter()
            try:
                loss = run.advance(stop.raise_if_set if processes.count == 1 else lambda: None)
            except StopRun:
                continue
            mean_loss = loss if math.isnan(mean_loss) else LOSS_SMOOTHING * mean_loss + (1.0 - LOSS_SMOOTHING) * loss
            spent(started)
            started, done = time.perf_counter(), run.progress >= 1.0
            if log is not None and run.step % config.log_every == 0:
                rate = (run.step - logged[0]) / max(60.0 * (run.minutes - logged[1]), 1e-9)
                logged = (run.step, run.minutes)
                rates = {"train/learning_rate": run.learning_rate(), "train/steps_per_s": rate}
                log.write(run.step, {"train/loss": mean_loss, **rates})
            if log is not None and run.held_out_objects and (run.step % config.validate_every == 0 or done):
                validation = run.validate()
                log.write(run.step, validation)
            if run.step % config.checkpoint_every == 0 or done:
                save()
            spent(started)
            bars.update(bar, completed=run.step, loss=mean_loss)
    return validation


def _is_model_of(folder: Path, step: int) -> bool:
    """Whether a whole model lies in the folder that was written after this step."""
    try:
        load_model(folder)
        return bool(read_provenance(folder).get("step") == step)
    except CheckpointError:
        return False


class StopRun(Exception):  # noqa: N818 - no error
    """A step was ended in its middle."""


class _Stop(threading.Event):
    def raise_if_set(self) -> None:
        """Raise StopRun once a signal has come."""
        if self.is_set():
            raise StopRun


@contextmanager
def _stop_signals() -> Iterator[_Stop]:
    """An event that SIGTERM and SIGINT set; the former handlers come back afterwards.

    Until then nothing ends the process by force: what a step and saving take is better spent than the steps lost.
    """
    stop = _Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # signals reach the main thread only
        return

    def handle(_signum: int, _frame: FrameType | None) -> None:
        stop.set()

    former = {number: signal.signal(number, handle) for number in (signal.SIGTERM, signal.SIGINT)}
    wakeup = signal.set_wakeup_fd(-1)
    try:
        yield stop
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in former.items():
            signal.signal(number, handler)
