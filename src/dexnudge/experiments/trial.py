"""A kind of trial: how one trial runs, what its record holds, and what is reported of many; trials that begin with draws."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic

from dexnudge.experiments.config import ExperimentConfig, TrialKey, brought, trial_seed
from dexnudge.experiments.metrics import Metric
from dexnudge.experiments.records import Record
from dexnudge.experiments.tables import Table
from dexnudge.results.samples import Samples
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import Criterion


@dataclass(frozen=True)
class Section:
    """A part of a report: a heading, a text, a table, and a chart (file name, function that draws it).

    numbers: what report.json holds under the heading.
    """

    title: str
    text: str = ""
    table: Table | None = None
    chart: tuple[str, Callable[[], Any]] | None = None
    numbers: Any = None


class TrialKind(ABC, Generic[Record]):
    """A kind of trial is a frozen dataclass that derives from this class, in one file.

    Its fields are the options that decide its records beside the experiment's configuration.

    Attributes:
        title: of its report. about: text below the title.
        folder: of its records in the folder of the experiment; "" for that folder itself.
        record: dataclass of its records.
        needs_verified: whether a trial has nothing to do without a verified draw.
        metrics: of its report. rate: name of the one that the bar chart shows.
    """

    title: ClassVar[str]
    about: ClassVar[str]
    folder: ClassVar[str]
    record: ClassVar[type[Any]]
    needs_verified: ClassVar[bool] = True
    metrics: ClassVar[Sequence[Metric]]
    rate: ClassVar[str]

    @abstractmethod
    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], Record]:
        """Load in a process what all of its trials need; return the function that runs one of them.

        A `DexnudgeError` of that function makes the trial a failed one.
        """

    def sections(self, records: Sequence[Record]) -> list[Section]:  # noqa: ARG002  most kinds have none
        """Return what the report says beside the tables of metrics."""
        return []

    def record_without_trial(
        self, config: ExperimentConfig, key: TrialKey, status: str, reason: str = "", *, num: int | None = None
    ) -> Record:
        """Return the record of a trial that failed, or that has no verified draw; its draws stay in the denominators."""
        return self.record(
            **key._asdict(),
            status=status,
            reason=reason,
            num=config.num if num is None else num,
            seed=trial_seed(config.seed, key),
        )


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
        terms, self.criteria, self._uncertainty = brought(config)
        self._sampler = Sampler(self.hand, terms=terms, weights=config.weights, poses=config.data, device=config.device)
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
        return replace(scene, uncertainty=self._uncertainty)

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
