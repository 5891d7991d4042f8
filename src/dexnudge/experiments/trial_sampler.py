"""The draws of a trial: an object put into a scene, drawn for and verified."""

import time
from dataclasses import dataclass

from dexnudge.experiments.config import ExperimentConfig, TrialKey, own_criteria, own_terms, trial_seed
from dexnudge.results.samples import Samples
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene


@dataclass(frozen=True)
class Drawn:
    """The scene of a trial and its samples; `seconds` by stage, as if the trial had prepared the scene for itself."""

    scene: Scene
    samples: Samples
    seconds: dict[str, float]


@dataclass(frozen=True)
class _Prepared:
    scene: Scene
    problem: SamplingProblem
    seconds: dict[str, float]


class TrialSampler:
    """Draws for one trial after another, with hand and weights loaded once, and a scene once for all methods.

    Raises:
        InputError, CheckpointError, DatasetError: hand, weights or data of the config cannot be used.
    """

    def __init__(self, config: ExperimentConfig) -> None:
        from dexnudge.hands.registry import load_hand
        from dexnudge.objects.sets import resolve_object_set

        self._config = config
        entries = resolve_object_set(config.objects, units=config.units, length=config.length)
        self._objects = {entry.name: entry for entry in entries}
        self.hand = load_hand(config.hand, base=config.base)
        self._sampler = Sampler(
            self.hand, terms=own_terms(config), weights=config.weights, poses=config.data, device=config.device
        )
        self._criteria = own_criteria(config)
        self._sampler.load(*config.methods)
        self._last: tuple[tuple[str, str], _Prepared] | None = None
        self._warm = False

    def draw(self, key: TrialKey) -> Drawn:
        """Return the draws of a trial; a `DexnudgeError` where the object cannot be read or does not fit its scene."""
        prepared = self._prepare(key)
        if not self._warm:
            self._draw(key, prepared, num=1)  # loads kernels: seconds that belong to no method
            self._warm = True
        samples = self._draw(key, prepared, num=self._config.num)
        return Drawn(prepared.scene, samples, {**prepared.seconds, **samples.seconds})

    def _draw(self, key: TrialKey, prepared: _Prepared, *, num: int) -> Samples:
        return self._sampler.sample(
            prepared.scene,
            num=num,
            seed=trial_seed(self._config.seed, key),
            method=find_method(key.method).with_weights(self._config.losses or {}),
            criteria=self._criteria,
            problem=prepared.problem,
        )

    def _prepare(self, key: TrialKey) -> _Prepared:
        from dexnudge.scenes.families import build_scene

        place = (key.object, key.scene)
        if self._last is None or self._last[0] != place:
            start = time.perf_counter()
            mesh = self._objects[key.object].load()
            seed = trial_seed(self._config.seed, key)
            scene = build_scene(key.scene, mesh, seed=seed, **(self._config.physics or {}))
            scene.validate()
            loaded = time.perf_counter()
            problem = prepare(scene, device=self._config.device)
            seconds = {"load": loaded - start, "prepare": time.perf_counter() - loaded}
            self._last = (place, _Prepared(scene, problem, seconds))
        return self._last[1]
