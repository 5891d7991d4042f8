"""Lifting: an object is slid by the verified draws of a trial to where it can be grasped, grasped, lifted and held."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from dexnudge.execution.grasp_and_lift import HOLD_TIME, LIFT
from dexnudge.execution.slide_grasp_lift import Attempt, SlideGraspLift
from dexnudge.experiments.metrics import FAILED, OBJECTS, UNVERIFIED, Metric, mean, share
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.trial import DrawnTrial, TrialSampler
from dexnudge.results.samples import Samples
from dexnudge.sampling.sampler import Sampler
from dexnudge.simulation.model import scene_model


@dataclass(frozen=True, kw_only=True)
class LiftingRecord(TrialRecord):
    """Slide, grasp and lift with the verified draws of a trial.

    Attributes:
        attempts: in their order; each goes on from where the one before has left hand and object.
        ended: value of the `Outcome` for which there were no more of them; "" for none.
        simulated: time in the simulation [s].
    """

    kind: ClassVar[str] = "lifting"

    attempts: list[Attempt] = field(default_factory=list)
    ended: str = ""
    simulated: float = 0.0

    @property
    def succeeded(self) -> bool:
        """Whether the object was lifted and held, at whichever attempt."""
        return any(each.success for each in self.attempts)

    def failure(self, number: int) -> str:
        """Return phase and outcome of an attempt (0 the first, -1 the last); "" for a success."""
        if self.status != "done":
            return "no draw verified" if self.status == "unverified" else "object failed"
        attempt = self.attempts[number]
        return "" if attempt.success else f"{attempt.phase}: {attempt.outcome.value.replace('_', ' ')}"


def _failures(number: int) -> Callable[[Sequence[LiftingRecord]], dict[str, int]]:
    """Objects that were not lifted at an attempt, by outcome, most frequent first."""
    return lambda records: dict(Counter(filter(None, (each.failure(number) for each in records))).most_common())


@dataclass(frozen=True)
class LiftingTrial(DrawnTrial[LiftingRecord]):
    """Slide, grasp and lift.

    The losses of the config are those of the draws; grasps are always drawn with their own.

    attempts: most for each object.
    """

    title: ClassVar[str] = "Slid, grasped, lifted"
    about: ClassVar[str] = (
        "Each object is slid by its verified draws, best first, to where it can be grasped, grasped there, lifted by "
        f"{100 * LIFT:g} cm and held for {HOLD_TIME:g} s. Lifted: % of all attempted objects with which one of the attempts "
        "succeeds, three unless told otherwise, besides slides that stop short and go on, up to seven; first attempt: "
        "without retries, that of a slide included. In brackets, 95 % intervals by bootstrap over objects. Attempts and "
        "seconds: mean over the objects that were played."
    )
    folder: ClassVar[str] = "lifted"
    record: ClassVar[type[LiftingRecord]] = LiftingRecord
    metrics: ClassVar[Sequence[Metric]] = (
        OBJECTS,
        FAILED,
        UNVERIFIED,
        Metric("lifted", share(lambda each: each.succeeded), "lifted"),
        Metric("at_first", share(lambda each: any(one.success for one in each.attempts[:1])), "first attempt"),
        Metric("attempts", mean(lambda each: float(len(each.attempts))), "attempts", 1),
        Metric("draw", mean(lambda each: each.seconds["draw"]), "draw, s", 1),
        Metric("play", mean(lambda each: each.seconds["play"]), "play, s", 1),
        Metric("simulated", mean(lambda each: each.simulated), "simulated, s", 1),
        Metric("outcomes", _failures(-1), "Why objects were not lifted", "counts"),
        Metric("first_outcomes", _failures(0), "Why first attempts failed", "counts"),
    )
    rate: ClassVar[str] = "lifted"

    attempts: int = 3

    def start_with(self, sampler: TrialSampler) -> Callable[[Samples, int], dict[str, Any]]:
        """Load the prior that grasps need whatever the method; return what plays the verified draws of a trial."""
        config = sampler.config
        grasps = Sampler.from_pretrained(sampler.hand, weights=config.weights, device=config.device)

        def play(samples: Samples, seed: int) -> dict[str, Any]:
            q, simulation = samples.verified.q.astype(np.float64), scene_model(sampler.hand, samples.scene)
            result = SlideGraspLift(samples.scene, simulation, q, grasps, seed=seed).run(self.attempts)
            return {
                "attempts": [_rounded(each) for each in result.attempts],
                "ended": "" if result.ended is None else result.ended.value,
                "simulated": 0.0 if result.trace is None else round(float(result.trace.time[-1]), 3),
            }

        return play


def _rounded(attempt: Attempt) -> Attempt:
    figures: dict[str, Any] = {
        name: round(value, 6) for name, value in vars(attempt).items() if isinstance(value, float)
    }
    return replace(attempt, **figures)
