"""Lifting: an object is slid by the verified draws of a trial to where it can be grasped, grasped, lifted and held."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from dexnudge.execution.grasp_and_lift import HOLD_TIME, LIFT
from dexnudge.execution.slide_grasp_lift import Attempt, SlideGraspLift, SlideGraspLiftResult
from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_seed
from dexnudge.experiments.metrics import FAILED, OBJECTS, UNVERIFIED, Metric
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.statistics import Estimate, mean_estimate, mean_of_known
from dexnudge.experiments.trial import TrialKind
from dexnudge.experiments.trial_sampler import Drawn, TrialSampler
from dexnudge.hands.hand import Hand
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
    def lifted(self) -> bool:
        """Whether the object was lifted and held, at whichever attempt."""
        return any(each.success for each in self.attempts)

    @property
    def lifted_at_first(self) -> bool:
        """Whether the first attempt did."""
        return any(each.success for each in self.attempts[:1])

    def outcome(self, number: int) -> str:
        """Return phase and outcome of an attempt (0 the first, -1 the last); "" for a success."""
        if self.status != "done":
            return "no draw verified" if self.status == "unverified" else "object failed"
        attempt = self.attempts[number]
        return "" if attempt.success else f"{attempt.phase}: {attempt.outcome.value.replace('_', ' ')}"


Records = Sequence[LiftingRecord]


def _outcomes(number: int) -> Callable[[Records], dict[str, int]]:
    """Objects that were not lifted at an attempt, by outcome, most frequent first."""

    def count(records: Records) -> dict[str, int]:
        return dict(Counter(outcome for each in records if (outcome := each.outcome(number))).most_common())

    return count


def _mean(value: Callable[[LiftingRecord], float]) -> Callable[[Records], Estimate | None]:
    """Mean over the objects that were played."""
    return lambda records: mean_of_known(value(each) for each in records if each.status == "done")


RATES = (
    OBJECTS,
    FAILED,
    UNVERIFIED,
    Metric("lifted", "lifted", lambda records: mean_estimate([float(each.lifted) for each in records])),
    Metric(
        "at_first", "first attempt", lambda records: mean_estimate([float(each.lifted_at_first) for each in records])
    ),
    Metric("attempts", "attempts", _mean(lambda each: float(len(each.attempts))), 1),
    Metric("draw", "draw, s", _mean(lambda each: each.seconds["draw"]), 1),
    Metric("play", "play, s", _mean(lambda each: each.seconds["play"]), 1),
    Metric("simulated", "simulated, s", _mean(lambda each: each.simulated), 1),
)


@dataclass(frozen=True)
class LiftingTrial(TrialKind[LiftingRecord]):
    """Slide, grasp and lift.

    The losses of the config are those of the draws; grasps are always drawn with their own.

    Attributes:
        tries: most attempts for each object.
    """

    title: ClassVar[str] = "Slid, grasped, lifted"
    about: ClassVar[str] = (
        "In one simulation each object is slid by its verified draws, best first, to where it can be grasped, grasped "
        f"there, lifted by {100 * LIFT:g} cm and held for {HOLD_TIME:g} s. Lifted: share of all attempted objects with "
        "which one of the attempts succeeds; first attempt: the share without retries. An object that failed, has no "
        "verified draw or cannot be slid to where it is graspable counts as one that is not lifted. In %; in brackets, "
        "95 % intervals by bootstrap over objects. Attempts and seconds: mean over the objects that were played."
    )
    folder: ClassVar[str] = "lifted"
    record: ClassVar[type[LiftingRecord]] = LiftingRecord
    tables: ClassVar[Mapping[str, Sequence[Metric]]] = {
        "": RATES,
        "Why objects were not lifted": (Metric("outcomes", "outcome", _outcomes(-1), 0),),
        "Why first attempts failed": (Metric("first_outcomes", "outcome", _outcomes(0), 0),),
    }
    rate: ClassVar[str] = "lifted"

    tries: int = 3

    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], LiftingRecord]:
        """Load the sampler, and the prior that grasps need whatever the method; return what runs a trial."""
        sampler = TrialSampler(config)
        grasps = Sampler.from_pretrained(sampler.hand, weights=config.weights, device=config.device)

        def run(key: TrialKey) -> LiftingRecord:
            clock, seed = time.perf_counter(), trial_seed(config.seed, key)
            drawn = sampler.draw(key)
            seconds = {"draw": round(time.perf_counter() - clock, 4)}
            common = {
                **key._asdict(),
                "seed": seed,
                "num": len(drawn.samples.q),
                "verified": drawn.samples.num_verified,
            }
            if not drawn.samples.num_verified:
                return LiftingRecord(**common, status="unverified", seconds=seconds)
            clock = time.perf_counter()
            result = self._play(sampler.hand, drawn, grasps, seed)
            return LiftingRecord(
                **common,
                attempts=[_rounded(each) for each in result.attempts],
                ended="" if result.ended is None else result.ended.value,
                simulated=0.0 if result.trace is None else round(float(result.trace.time[-1]), 3),
                seconds={**seconds, "play": round(time.perf_counter() - clock, 4)},
            )

        return run

    def succeeded(self, record: LiftingRecord) -> bool:
        """Whether the object was lifted and held."""
        return record.lifted

    def _play(self, hand: Hand, drawn: Drawn, grasps: Sampler, seed: int) -> SlideGraspLiftResult:
        indices = np.flatnonzero(drawn.samples.success)
        q, simulation = drawn.samples.q[indices].astype(np.float64), scene_model(hand, drawn.scene)
        return SlideGraspLift(drawn.scene, simulation, q, indices, grasps, seed=seed).run(self.tries)


def _rounded(attempt: Attempt) -> Attempt:
    figures: dict[str, Any] = {
        name: round(value, 6) for name, value in vars(attempt).items() if isinstance(value, float)
    }
    return replace(attempt, **figures)
