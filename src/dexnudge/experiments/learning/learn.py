"""Learn a hand: data, training and evaluation in one folder, in so many minutes; what was stopped goes on.

HAND/ is a prepared hand. HAND/learning/ holds the plan, the three stages and the report, HAND/weights/ the model.
"""

import hashlib
import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from dexnudge.dataset.manifest import MANIFEST_NAME
from dexnudge.diffusion.checkpoint import CONFIG_NAME, MODEL_FOLDER, WEIGHTS_NAME
from dexnudge.diffusion.model_card import CARD_NAME
from dexnudge.diffusion.training import train
from dexnudge.errors import InputError, OutputError, check_integer, check_seed
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.learning.plan import (
    LONGEST,
    METHODS,
    LearningPlan,
    check_minutes,
    plan_learning,
    training_config,
)
from dexnudge.experiments.learning.rates import measure_rates
from dexnudge.experiments.learning.report import write_learning_report
from dexnudge.experiments.report import write_report
from dexnudge.experiments.run import FILE, TrialRunner
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import PREPARED_NAME, load_hand
from dexnudge.jobs.atomic_files import remove_leftovers, replace_atomically
from dexnudge.jobs.digests import KEY, is_as_signed, signed
from dexnudge.jobs.folders import owned_folder
from dexnudge.jobs.json_files import MAX_TABLE_BYTES, Must, from_fields, read_json_object
from dexnudge.jobs.processes import MOST_WORKERS, available_cores
from dexnudge.jobs.progress import progress
from dexnudge.jobs.provenance import machine, versions
from dexnudge.sampling.sampler import WEIGHTS_FOLDER
from dexnudge.synthesis.dataset_card import CARD_FILE, write_card
from dexnudge.synthesis.generate import generate_dataset
from dexnudge.synthesis.object_data import GenerationConfig

EVERY = 5.0  # [s] between writes: what a kill can hide


@dataclass(frozen=True)
class _Spent:
    seconds: dict[str, Annotated[float, Must("a time", lambda seconds: 0.0 <= seconds <= 60.0 * LONGEST)]]


class StageClock:
    """Counts the seconds of stages in a file.

    Attributes:
        seconds: of each stage so far, in the order in which they began.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.seconds: dict[str, float] = {}
        self._running: tuple[str, float] | None = None
        with suppress(InputError):  # there is none yet, or a failing disk has lost what is no result
            content = {"seconds": read_json_object(path, error=InputError)}
            self.seconds = from_fields(content, _Spent, str(path), error=InputError, again="").seconds

    @property
    def total(self) -> float:
        """Seconds of all stages until now."""
        self._count()
        return sum(self.seconds.values())

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the seconds of the block to a stage."""
        ended = threading.Event()
        self._running = (name, self.seconds.get(name, 0.0) - time.monotonic())

        self._count()

        def count() -> None:
            self._count()
            with replace_atomically(self._path) as temporary:
                temporary.write_text(json.dumps(self.seconds, indent=2) + "\n", encoding="utf-8")

        def count_on() -> None:
            while not ended.wait(EVERY):
                with suppress(OutputError):  # the stage itself says that the disk is full
                    count()

        counter = threading.Thread(target=count_on, daemon=True)
        counter.start()
        try:
            yield
        finally:
            ended.set()
            counter.join()
            with suppress(OutputError):
                count()
            self._running = None

    def _count(self) -> None:
        if self._running:
            name, before = self._running
            self.seconds[name] = before + time.monotonic()


FOLDER, PLAN, CLOCK = "learning", "plan.json", "clock.json"
DATA, TRAINING, EVALUATION = "data", "training", "evaluation"
DEFAULT_MINUTES = 60.0
MINUTES_OF_GRASPS = 30.0  # budgets below this never reach grasps, so that these are not timed
LEAST_TRAINING = 0.25  # share of its planned time that training gets, also where the data took too long


@dataclass(frozen=True)
class Learned:
    """report: its text. succeeded: whether any draw with the learned weights did, in any scene."""

    report: str
    succeeded: bool


def learn_hand(
    folder: Path | str,
    *,
    minutes: float | None = None,
    workers: int | None = None,
    seed: int | None = None,
    say: Callable[[str], None] = print,
) -> Learned:
    """Learn the hand of a prepared folder; go on where an earlier call was stopped.

    minutes: of wall-clock time, earlier calls included; those of the plan, or 60, unless given. workers: processes, and
    threads of training; as many as there are cores unless given. say: told the plan, and each stage as it begins.

    Raises:
        InputError: fewer minutes than the least that is of use; or the folder's plan is of other minutes, another seed,
            or a hand that has changed since.
        DatasetError: nothing that the hand does is kept. OutputError: the folder cannot be written.
        KeyboardInterrupt: training was stopped by a signal, with everything saved.
    """
    folder = Path(folder)
    hand = load_hand(folder / PREPARED_NAME)
    check_minutes(minutes)
    if workers is not None:
        check_integer("workers", workers, least=1, most=MOST_WORKERS)
    if seed is not None:
        check_seed(seed)
    with owned_folder(folder / FOLDER) as learning:
        for written in (learning, folder / WEIGHTS_FOLDER):
            remove_leftovers(written)
        if not (learning / PLAN).is_file():
            (learning / CLOCK).unlink(missing_ok=True)  # of a start that was refused or killed before it had a plan
            say("measuring how fast this machine is")
        clock = StageClock(learning / CLOCK)
        with clock.stage("measuring"):
            plan = _plan(folder, hand, clock, minutes=minutes, workers=workers, seed=seed)
        say(str(plan))
        with clock.stage(DATA):
            _generate(folder, plan)
        say(f"data after {clock.total / 60.0:.1f} min; training")
        with clock.stage(TRAINING):
            _train(learning, plan, clock)
            _copy_model(learning / TRAINING / MODEL_FOLDER, folder / WEIGHTS_FOLDER)
        say(f"model after {clock.total / 60.0:.1f} min: {folder / WEIGHTS_FOLDER}; evaluation")
        with clock.stage(EVALUATION):
            scenes = _evaluate(folder, plan, clock)
        with clock.stage("report"):
            return Learned(*write_learning_report(folder, hand, plan, clock.seconds, scenes))


def _plan(
    folder: Path, hand: Hand, clock: StageClock, *, minutes: float | None, workers: int | None, seed: int | None
) -> LearningPlan:
    """The plan that was made once, or one made now from what is measured."""
    path = folder / FOLDER / PLAN
    if path.is_file():
        return _read_plan(path, hand_digest(folder), minutes=minutes, seed=seed)
    minutes, seed = minutes or DEFAULT_MINUTES, seed or 0
    workers = workers or available_cores()
    grasps = minutes >= MINUTES_OF_GRASPS
    rates = measure_rates(
        hand, training_config(1000, grasps=grasps, threads=workers, seed=seed), seed=seed, grasps=grasps
    )
    plan = plan_learning(minutes, rates, workers=workers, seed=seed, measuring=clock.total)
    write_plan(folder, hand, plan)
    return plan


def write_plan(folder: Path, hand: Hand, plan: LearningPlan) -> None:
    """Make `plan` the one that learning this prepared hand follows; OutputError where it cannot be written."""
    content = {"hand": hand.name, "hand_sha256": hand_digest(folder), "plan": asdict(plan)}
    content |= {"versions": versions(), "machine": machine()}
    with replace_atomically(folder / FOLDER / PLAN) as temporary:
        temporary.write_text(json.dumps(signed(content), indent=2) + "\n", encoding="utf-8")


def _read_plan(path: Path, described: str, *, minutes: float | None, seed: int | None) -> LearningPlan:
    again = f"remove {path.parent} to learn anew"
    content = read_json_object(path, error=InputError, again=again)
    plan = from_fields(content.get("plan"), LearningPlan, f"{path}: plan", error=InputError, again=again)
    if not is_as_signed(content):
        raise InputError(
            f"{path} has changed since it was written: its checksum is another, and data and model beside it follow what it "
            f"was; put it back as it was, or {again}"
        )
    if content.get("hand_sha256") != described:
        raise InputError(
            f"the hand in {path.parent.parent} is not the one that {path} was made for; expected the same description, "
            f"YAML and meshes; {again}"
        )
    for name, given, planned in (("minutes", minutes, plan.minutes), ("seed", seed, plan.seed)):
        if given is not None and given != planned:
            raise InputError(f"{path} is a plan with `{name}` {planned:g}, got {given:g}; give the same, or {again}")
    return plan


def hand_digest(folder: Path) -> str:
    """Return the SHA-256 of a prepared hand's description, YAML and meshes."""
    digest = hashlib.sha256()
    for file in (folder / PREPARED_NAME, folder / "hand.yaml", *sorted((folder / "meshes").glob("*"))):
        if file.is_file():
            digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def _generate(folder: Path, plan: LearningPlan) -> None:
    out = folder / FOLDER / DATA
    config = GenerationConfig(hand=str(folder / PREPARED_NAME), non_prehensile=plan.attempts, grasps=plan.grasps)
    generate_dataset(f"builtin:train:{plan.objects}", out, config, seed=plan.seed, workers=plan.workers)
    written = out / CARD_FILE
    if not written.is_file() or written.stat().st_mtime < (out / MANIFEST_NAME).stat().st_mtime:
        write_card(out)


def _train(learning: Path, plan: LearningPlan, clock: StageClock) -> None:
    """Take the planned steps, or as many as the time allows that the other stages leave."""
    config = training_config(
        plan.steps, grasps=plan.grasps > 0, threads=plan.workers, step=plan.rates.step, seed=plan.seed
    )
    others = sum(seconds for stage, seconds in clock.seconds.items() if stage in ("measuring", DATA))
    seconds = max(60.0 * plan.minutes - others - plan.evaluation, LEAST_TRAINING * plan.training)
    config = replace(config, max_minutes=seconds / 60.0)
    result = train(learning / DATA, learning / TRAINING, config, made_with={**machine(), **versions()})
    if not result.finished:
        raise KeyboardInterrupt


def _copy_model(model: Path, weights: Path) -> None:
    """Copy the model's files, each whole or not at all; the one that vouches for the others comes last."""
    for name in (CARD_NAME, WEIGHTS_NAME, CONFIG_NAME):
        with replace_atomically(weights / name) as temporary:
            shutil.copyfile(model / name, temporary)


def _evaluate(folder: Path, plan: LearningPlan, clock: StageClock) -> tuple[str, ...]:
    """Run the trials of each scene; return the scenes, without those that the time did not suffice for."""
    done: list[str] = []
    each = plan.evaluation / len(plan.scenes)
    for scene in plan.scenes:
        out = folder / FOLDER / EVALUATION / scene
        if done and not (out / FILE).is_file() and clock.total + each > 60.0 * plan.minutes:
            break
        config = ExperimentConfig(
            objects="builtin:test",
            max_objects=plan.trial_objects,
            scenes=(scene,),
            methods=METHODS,
            num=plan.draws,
            seed=plan.seed,
            hand=str(folder / PREPARED_NAME),  # whose weights lie beside it
        )
        _follow(out / FILE, config)
        _run_trials(config, out, workers=plan.workers)
        done.append(scene)
    return tuple(done)


def _run_trials(config: ExperimentConfig, out: Path, *, workers: int) -> None:
    kind = SamplingTrial()
    with progress() as bars:
        bar = bars.add_task(f"evaluation, {config.scenes[0]}", total=None)

        def show(_kind: Any, records: Sequence[Any], total: int) -> None:
            bars.update(bar, completed=len(records), total=total)

        for _ in TrialRunner([kind], config, out).run(workers=workers, on_record=show):
            write_report(kind, out)


def _follow(file: Path, config: ExperimentConfig) -> None:
    """Let an experiment of this same hand know where the folder is now, if it was moved; InputError for another one."""
    if not file.is_file():
        return
    again = f"remove {file.parent} to have it evaluated again"
    content = read_json_object(file, error=InputError, again=again, largest=MAX_TABLE_BYTES)
    theirs, ours = content.get("config"), json.loads(json.dumps(asdict(config)))
    if (
        not is_as_signed(content)
        or not isinstance(theirs, dict)
        or any(theirs.get(key) != value for key, value in ours.items() if key != "hand")
    ):
        raise InputError(
            f"{file} is of another evaluation than the plan's, or has changed since it was written; {again}"
        )
    if theirs.get("hand") != config.hand:
        content = {key: value for key, value in content.items() if key != KEY}
        content["config"] = {**theirs, "hand": config.hand}
        with replace_atomically(file) as temporary:
            temporary.write_text(json.dumps(signed(content), indent=2) + "\n", encoding="utf-8")
