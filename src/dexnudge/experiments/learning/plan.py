"""How the minutes of learning a hand are spent: rates that were measured in, numbers of everything out; nothing is done."""

import math
from dataclasses import dataclass
from typing import Annotated

from dexnudge.diffusion.config import Architecture, TrainingConfig
from dexnudge.errors import InputError
from dexnudge.jobs.json_files import AT_LEAST_0

SCENES = ("table", "layers", "shelf")  # in the order in which they are evaluated
METHODS = ("steered_noise", "random_start_projection")  # what was learned, beside the same without it
DRAWS = 16  # of each trial
MOST_TRIAL_OBJECTS = 20  # of builtin:test: the interval of a rate of 90 % is then some +-5 %
FEWEST_TRIAL_OBJECTS = 2
FEWEST_IN_EVERY_SCENE = 8  # with fewer objects than this the time goes to the table alone
MOST_OBJECTS = 320  # builtin:train
FEWEST_OBJECTS = 4
BATCH = 256  # attempts that descend together
MOST_BATCHES = 2  # for each object: then more rows of it teach little
GRASPS = (8, 32)  # fewest and most attempts for each object; a few times as dear as other attempts
MOST_STEPS = 20_000  # the validation error of shadow_lite falls by less than 1 % from there on
FEWEST_STEPS = 100
DATA_SHARE = 0.3  # of the time beyond the least that every stage needs
EVALUATION_SHARE = 0.1
RESERVE = 0.03  # share of the minutes that is left for reports, pictures, and a machine that slows down
START_FROM = "shadow_lite"  # whose weights ship
SAVED_EVERY = 30.0  # [s] of training that a kill may cost
VALIDATIONS = 8
AVERAGED_SHARE = 0.05  # of the steps that the averaged weights remember
LONGEST_AVERAGE = 0.999  # decay: some 1000 steps

LONGEST = 1e7  # [min] as of training

Amount = Annotated[float, AT_LEAST_0]
Count = Annotated[int, AT_LEAST_0]


def check_minutes(minutes: float | None) -> None:
    """Refuse minutes that nothing could be learned in, or that nobody waits for; InputError."""
    if minutes is not None and not 0.0 < minutes <= LONGEST:
        raise InputError(f"`minutes` is {minutes}; expected more than 0, at most {LONGEST:g}")


@dataclass(frozen=True, kw_only=True)
class LearningRates:
    """What one process takes on this machine [s].

    Attributes:
        start: until it has loaded everything. attempt: at a push, press or hook. kept: share of these that is kept.
        grasp: attempt at a grasp; None leaves grasps out. step: of training, with the threads that it will have.
        trial: an object in a scene, prepared, drawn for with each of `METHODS` and verified.
    """

    start: Amount = 10.0
    attempt: Amount
    kept: Amount
    grasp: Amount | None = None
    step: Amount
    trial: Amount


@dataclass(frozen=True, kw_only=True)
class LearningPlan:
    """What is done in the minutes.

    Attributes:
        objects: of builtin:train. attempts: at pushes, presses and hooks for each; grasps: likewise.
        steps: of training. scenes: that are evaluated, with `trial_objects` of builtin:test and `draws` for each.
        measuring, data, training, evaluation: what the stages are expected to take [s].
    """

    minutes: Amount
    workers: Count
    seed: Count
    objects: Count
    attempts: Count
    grasps: Count
    steps: Count
    scenes: tuple[str, ...]
    trial_objects: Count
    draws: Count = DRAWS
    measuring: Amount
    data: Amount
    training: Amount
    evaluation: Amount
    rates: LearningRates

    @property
    def rows(self) -> int:
        """Rows of pushes, presses and hooks that are expected."""
        return round(self.objects * self.attempts * self.rates.kept)

    @property
    def cuts(self) -> tuple[str, ...]:
        """What the minutes do not suffice for, a sentence each."""
        found = []
        if self.objects < MOST_OBJECTS:
            found.append(f"data from {self.objects} of the {MOST_OBJECTS} objects of builtin:train")
        if self.attempts < MOST_BATCHES * BATCH:
            found.append(f"{self.attempts} attempts for each object, where up to {MOST_BATCHES * BATCH} teach more")
        if not self.grasps:
            found.append("no grasps in the data: `execute` finds fewer grasps after the push")
        if self.steps < MOST_STEPS:
            found.append(f"{self.steps:,} steps of training, where up to {MOST_STEPS:,} teach more")
        if missing := [scene for scene in SCENES if scene not in self.scenes]:
            found.append(f"no evaluation in the scenes {', '.join(missing)}")
        if self.trial_objects < MOST_TRIAL_OBJECTS:
            found.append(
                f"{self.trial_objects} objects in the evaluation, where {MOST_TRIAL_OBJECTS} give narrower intervals"
            )
        return tuple(found)

    def __str__(self) -> str:
        grasps = f" and {self.grasps} at grasps" if self.grasps else ""
        attempts = f"{self.attempts} attempts at pushes, presses and hooks{grasps}"
        trials = f"{self.trial_objects} unseen objects x {self.draws} draws, {', '.join(self.scenes)}"
        return "\n".join(
            [
                f"plan for {self.minutes:g} min, {self.workers} processes:",
                f"  {_minutes(self.data)} data: {self.objects} objects x {attempts}; some {self.rows:,} rows",
                f"  {_minutes(self.training)} training: {self.steps:,} steps",
                f"  {_minutes(self.evaluation)} evaluation: {trials}",
                *(f"  cut: {each}" for each in self.cuts),
            ]
        )


def plan_learning(
    minutes: float, rates: LearningRates, *, workers: int, seed: int = 0, measuring: float = 0.0
) -> LearningPlan:
    """Return what fits into the minutes, of which `measuring` seconds are spent.

    Every stage gets the least that it needs. Of the rest, data and evaluation get their shares, up to what is of use, and
    training what they leave.

    Raises:
        InputError: fewer minutes than every stage's least; the message says how many are needed.
    """
    least_data = _data_seconds(rates, workers, FEWEST_OBJECTS, BATCH, 0)
    least_evaluation = _evaluation_seconds(rates, workers, 1, FEWEST_TRIAL_OBJECTS)
    least = least_data + FEWEST_STEPS * rates.step + least_evaluation
    available = 60.0 * minutes * (1.0 - RESERVE) - measuring
    if available < least:
        floor = math.ceil(10.0 * (least + measuring) / (60.0 * (1.0 - RESERVE))) / 10.0
        raise InputError(
            f"`minutes` is {minutes:g}; expected at least {floor:g} on this machine: {FEWEST_OBJECTS} objects with {BATCH} "
            f"attempts each, {FEWEST_STEPS} steps of training and an evaluation with {FEWEST_TRIAL_OBJECTS} objects take "
            "that long"
        )
    objects, attempts, grasps = _data(rates, workers, least_data + DATA_SHARE * (available - least))
    scenes, trial_objects = _trials(rates, workers, least_evaluation + EVALUATION_SHARE * (available - least))
    data = _data_seconds(rates, workers, objects, attempts, grasps)
    evaluation = _evaluation_seconds(rates, workers, len(scenes), trial_objects)
    steps = min(MOST_STEPS, math.floor((available - data - evaluation) / rates.step))
    return LearningPlan(
        minutes=minutes,
        workers=workers,
        seed=seed,
        objects=objects,
        attempts=attempts,
        grasps=grasps,
        steps=steps,
        scenes=scenes,
        trial_objects=trial_objects,
        measuring=measuring,
        data=data,
        training=steps * rates.step,
        evaluation=evaluation,
        rates=rates,
    )


def training_config(plan_steps: int, *, grasps: bool, threads: int, step: float = 0.0, seed: int = 0) -> TrainingConfig:
    """Return the recipe for so many steps; step: seconds of one, which decides how often the state is saved."""
    return TrainingConfig(
        steps=plan_steps,
        groups=32,
        rows_per_group=16,
        warmup_steps=min(500, max(1, plan_steps // 10)),
        ema_decay=min(LONGEST_AVERAGE, 1.0 - 1.0 / max(2.0, AVERAGED_SHARE * plan_steps)),
        grasp_fraction=0.2 if grasps else 0.0,
        min_direction_margin=1.5,
        validate_every=max(1, math.ceil(plan_steps / VALIDATIONS)),
        checkpoint_every=max(1, round(SAVED_EVERY / step)) if step else plan_steps,
        start_from=START_FROM,
        num_threads=threads,
        seed=seed,
        architecture=Architecture(token_layout="single"),  # noqa: S106 - a transformer's tokens, no secret
    )


def _data(rates: LearningRates, workers: int, seconds: float) -> tuple[int, int, int]:
    """Objects first, since they teach more than rows of the same; then attempts, then grasps."""
    work = workers * (seconds - rates.start)
    objects = _between(FEWEST_OBJECTS, math.floor(work / (BATCH * rates.attempt)), MOST_OBJECTS)
    batches = _between(1, math.floor(work / (objects * BATCH * rates.attempt)), MOST_BATCHES)
    grasps = 0
    if rates.grasp is not None and objects == MOST_OBJECTS:
        left = work / objects - batches * BATCH * rates.attempt
        grasps = min(math.floor(left / rates.grasp), GRASPS[1])
    return objects, batches * BATCH, grasps if grasps >= GRASPS[0] else 0


def _trials(rates: LearningRates, workers: int, seconds: float) -> tuple[tuple[str, ...], int]:
    """All scenes where they get enough objects, else the table alone."""
    for scenes in (SCENES, SCENES[:1]):
        objects = math.floor(workers * (seconds / len(scenes) - rates.start) / rates.trial)
        if objects >= FEWEST_IN_EVERY_SCENE:
            break
    return scenes, _between(FEWEST_TRIAL_OBJECTS, objects, MOST_TRIAL_OBJECTS)


def _data_seconds(rates: LearningRates, workers: int, objects: int, attempts: int, grasps: int) -> float:
    return rates.start + objects * (attempts * rates.attempt + grasps * (rates.grasp or 0.0)) / workers


def _evaluation_seconds(rates: LearningRates, workers: int, scenes: int, objects: int) -> float:
    return scenes * (rates.start + objects * rates.trial / workers)


def _between(least: int, number: int, most: int) -> int:
    return max(least, min(number, most))


def _minutes(seconds: float) -> str:
    return f"{seconds / 60.0:.1f} min"
