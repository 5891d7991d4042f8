"""Trials that begin with draws: an object put into a scene, drawn for and verified."""

import time
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from dexnudge.experiments.config import ExperimentConfig, TrialKey, own_criteria, own_terms, own_uncertainty, trial_seed
from dexnudge.experiments.records import Record
from dexnudge.experiments.trial import TrialKind
from dexnudge.results.samples import Samples
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import Criterion


class TrialSampler:
    """Draws for one trial after another, with hand and weights loaded once, and a scene once for all methods.

    Raises:
        InputError, CheckpointError, DatasetError: hand, weights or data of the config cannot be used.
    """

    def __init__(self, config: ExperimentConfig) -> None:
        from dexnudge.hands.registry import load_hand
        from dexnudge.objects.sets import resolve_object_set

        self.config = config
        entries = resolve_object_set(config.objects, units=config.units, length=config.length)
        self._objects = {entry.name: entry for entry in entries}
        self.hand = load_hand(config.hand, base=config.base)
        self._sampler = Sampler(
            self.hand, terms=own_terms(config), weights=config.weights, poses=config.data, device=config.device
        )
        self.criteria = own_criteria(config)
        self._sampler.load(*config.methods)
        self._last: tuple[tuple[str, str], SamplingProblem, dict[str, float]] | None = None
        self._warm = False

    def scene(self, key: TrialKey) -> Scene:
        """Return the scene of a trial, validated.

        Raises:
            DexnudgeError: the object cannot be read or does not fit its scene.
        """
        mesh = self._objects[key.object].load()
        scene = build_scene(key.scene, mesh, seed=trial_seed(self.config.seed, key), **(self.config.physics or {}))
        scene.validate()
        return replace(scene, uncertainty=own_uncertainty(self.config))

    def draw(self, key: TrialKey, further: Callable[[Scene], Sequence[Criterion]] = lambda _: ()) -> Samples:
        """Return the draws of a trial, with its seconds by stage as if it had prepared the scene for itself.

        further: conditions of success in a scene, beside those of the config.

        Raises:
            DexnudgeError: the object cannot be read or does not fit its scene.
        """
        problem, seconds = self._prepare(key)
        if not self._warm:
            self._draw(key, problem, num=1)  # loads kernels: seconds that belong to no method
            self._warm = True
        samples = self._draw(key, problem, num=self.config.num, further=further(problem.scene))
        return replace(samples, seconds={**seconds, **samples.seconds})

    def draw_in(self, scene: Scene, key: TrialKey) -> Samples:
        """Return the draws of a trial in another scene than its own."""
        start = time.perf_counter()
        problem = prepare(scene, device=self.config.device)
        prepared = time.perf_counter() - start
        samples = self._draw(key, problem, num=self.config.num)
        return replace(samples, seconds={"prepare": prepared, **samples.seconds})

    def _draw(self, key: TrialKey, problem: SamplingProblem, *, num: int, further: Sequence[Criterion] = ()) -> Samples:
        return self._sampler.sample(
            problem.scene,
            num=num,
            seed=trial_seed(self.config.seed, key),
            method=find_method(key.method).with_weights(self.config.losses or {}),
            criteria=[*self.criteria, *further],
            problem=problem,
        )

    def _prepare(self, key: TrialKey) -> tuple[SamplingProblem, dict[str, float]]:
        place = (key.object, key.scene)
        if self._last is None or self._last[0] != place:
            start = time.perf_counter()
            scene = self.scene(key)
            loaded = time.perf_counter()
            problem = prepare(scene, device=self.config.device)
            self._last = (place, problem, {"load": loaded - start, "prepare": time.perf_counter() - loaded})
        return self._last[1:]


class DrawnTrial(TrialKind[Record]):
    """A kind of trial that does something with the draws for an object in a scene."""

    @abstractmethod
    def start_with(self, sampler: TrialSampler) -> Callable[[Samples, int], dict[str, Any]]:
        """Load what is needed beside the sampler; return what makes fields of a record of draws and their seed.

        Where `needs_verified`, it is not asked for a trial without a verified draw.
        """

    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], Record]:
        """Load the sampler; return what draws for a trial and goes on with the draws."""
        sampler = TrialSampler(config)
        go_on = self.start_with(sampler)

        def run(key: TrialKey) -> Record:
            start, seed = time.perf_counter(), trial_seed(config.seed, key)
            samples = sampler.draw(key)
            drawn = time.perf_counter()
            unverified = self.needs_verified and not samples.num_verified
            found = {} if unverified else go_on(samples, seed)
            seconds = {"draw": drawn - start, "play": time.perf_counter() - drawn}
            return self.record(
                **key._asdict(),
                **found,
                status="unverified" if unverified else "done",
                seed=seed,
                num=len(samples),
                verified=samples.num_verified,
                seconds={
                    stage: round(value, 4)
                    for stage, value in (seconds if self.needs_verified else samples.seconds).items()
                },
            )

        return run
