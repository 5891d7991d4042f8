"""One row of an experiment: an object put into a scene, drawn for, judged, and measured."""

import time
from dataclasses import dataclass

import numpy as np

from dexnudge.errors import DexnudgeError
from dexnudge.experiments.config import ExperimentConfig, Task, row_seed
from dexnudge.experiments.diversity import contact_diversity, joint_diversity
from dexnudge.experiments.rows import Row
from dexnudge.experiments.sweeps import FORCE, sweep_success
from dexnudge.hands.hand import Hand
from dexnudge.results.samples import Samples
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.scenes.scene import Scene


@dataclass(frozen=True)
class DrawnTask:
    """The scene of a task and its draws, judged; `seconds` by stage."""

    scene: Scene
    draws: Samples
    seconds: dict[str, float]


@dataclass(frozen=True)
class _Prepared:
    """A scene made ready, and the seconds that each of its rows would have spent on it alone."""

    scene: Scene
    problem: SamplingProblem
    seconds: dict[str, float]


class RowMaker:
    """Computes rows one after another, with the hand and the weights loaded once, and a scene once for all methods."""

    def __init__(self, config: ExperimentConfig) -> None:
        from dexnudge.hands.registry import load_hand
        from dexnudge.objects.sets import resolve_object_set
        from dexnudge.sampling.sampler import Sampler

        self._config = config
        entries = resolve_object_set(config.objects, units=config.units, length=config.length)
        self._objects = {entry.name: entry for entry in entries}
        self.hand = load_hand(config.hand, base=config.base)
        self._sampler = Sampler(self.hand, weights=config.weights, poses=config.data, device=config.device)
        self._sampler.load(*config.methods)
        self._last: tuple[tuple[str, str], _Prepared] | None = None
        self._warm = False

    def __call__(self, task: Task) -> Row:
        """The row of a task. An object that cannot be read or does not fit its scene gives a failed row."""
        config = self._config
        try:
            self._prepare(task)
        except DexnudgeError as error:
            return failed_row(config, task, f"{type(error).__name__}: {error}")
        drawn = self.draw(task)
        return sampled_row(task, drawn, self.hand, seed=row_seed(config.seed, task), sweep=config.sweep)

    def draw(self, task: Task) -> DrawnTask:
        """What the row of a task is made from; a DexnudgeError where the object cannot be read or does not fit."""
        prepared = self._prepare(task)
        if not self._warm:
            self._draw(task, prepared, num=1)  # loads kernels: seconds that belong to no method
            self._warm = True
        draws = self._draw(task, prepared, num=self._config.num)
        return DrawnTask(prepared.scene, draws, {**prepared.seconds, **draws.seconds})

    def _draw(self, task: Task, prepared: _Prepared, *, num: int) -> Samples:
        return self._sampler.sample(
            prepared.scene,
            num=num,
            seed=row_seed(self._config.seed, task),
            method=find_method(task.method).with_weights(self._config.losses or {}),
            problem=prepared.problem,
        )

    def _prepare(self, task: Task) -> _Prepared:
        from dexnudge.scenes.families import build_scene

        key = (task.object, task.scene)
        if self._last is None or self._last[0] != key:
            start = time.perf_counter()
            mesh = self._objects[task.object].load()
            seed = row_seed(self._config.seed, task)
            scene = build_scene(task.scene, mesh, seed=seed, **(self._config.physics or {}))
            scene.validate()
            loaded = time.perf_counter()
            problem = prepare(scene, device=self._config.device)
            seconds = {"load": loaded - start, "prepare": time.perf_counter() - loaded}
            self._last = (key, _Prepared(scene, problem, seconds))
        return self._last[1]


def sampled_row(task: Task, drawn: DrawnTask, hand: Hand, *, seed: int, sweep: bool) -> Row:
    """The row of a task whose draws are judged."""
    scene, draws = drawn.scene, drawn.draws
    verdicts = draws.verdicts
    deepest = verdicts.deepest_penetration
    contacts = {row: verdicts.contacts[row] for row, reason in enumerate(verdicts.reasons) if reason in ("", FORCE)}
    verified = np.flatnonzero(verdicts.success)
    return Row(
        object=task.object,
        scene=task.scene,
        method=task.method,
        status="sampled",
        num=len(draws.q),
        seed=seed,
        success=verdicts.success.tolist(),
        force_margin=[round(float(margin), 4) for margin in verdicts.force_margin],
        penetration_mm=[round(1e3 * depth, 4) if np.isfinite(depth) else None for depth in deepest.tolist()],
        own_rank=[] if draws.own_rank is None else draws.own_rank.tolist(),
        joint_diversity=joint_diversity(draws.q[verified]),
        contact_diversity=contact_diversity(hand, scene, [contacts[index] for index in verified.tolist()]),
        swept=sweep_success(scene, verdicts, contacts) if sweep else {},
        rejected=draws.rejections(),
        seconds={stage: round(value, 4) for stage, value in drawn.seconds.items()},
    )


def failed_row(config: ExperimentConfig, task: Task, reason: str) -> Row:
    """A row that counts as `num` draws without success."""
    return Row(
        object=task.object,
        scene=task.scene,
        method=task.method,
        status="failed",
        reason=reason,
        num=config.num,
        seed=row_seed(config.seed, task),
    )
