"""The records of sampling trials, and the figures of many: what single draws, the top-ranked one and any of them reach."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.disturbances import AS_DRAWN
from dexnudge.experiments.metrics import (
    FAILED,
    OBJECTS,
    Measured,
    Metric,
    by_scene_and_method,
    mean,
    measure,
    named,
    share,
)
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.statistics import Estimate, chance_of_top, estimate_of_sums, mean_estimate, ratio
from dexnudge.verification.criteria import PENETRATION_LIMIT, ROBUST_MARGIN

LOADING = "load"  # the stage that is not the method's
DEEP_QUANTILE = 0.95  # of the worst depth: what the worst of twenty draws reaches


@dataclass(frozen=True, kw_only=True)
class SamplingRecord(TrialRecord):
    """The verified draws of a trial; lists are in ranked order: verified ones first, best first.

    Attributes:
        success, force_margin: of each draw.
        penetration_mm: the deepest of the three penetrations of each draw; null where the draw is no pose.
        own_rank: place of each draw in the sampler's own order, before verification.
        joint_diversity [rad], contact_diversity [half lengths of the object]: of the verified draws; null where fewer
            than two are.
        swept: success of each draw at other frictions and masses, by `disturbances.setting_name`; empty where the
            experiment does not ask for it.
        rejected: draws that did not succeed, by reason.
        repairs: what was repaired or assumed when the object was read, a sentence each.
    """

    kind: ClassVar[str] = "sampling"

    success: list[bool] = field(default_factory=list)
    force_margin: list[float] = field(default_factory=list)
    penetration_mm: list[float | None] = field(default_factory=list)
    own_rank: list[int] = field(default_factory=list)
    joint_diversity: float | None = None
    contact_diversity: float | None = None
    swept: dict[str, list[bool]] = field(default_factory=dict)
    rejected: dict[str, int] = field(default_factory=dict)
    repairs: list[str] = field(default_factory=list)

    @property
    def robust(self) -> list[bool]:
        """Which draws succeed with a force margin of at least `ROBUST_MARGIN`."""
        return [ok and margin >= ROBUST_MARGIN for ok, margin in zip(self.success, self.force_margin, strict=True)]

    @property
    def depths(self) -> list[float]:
        """Penetrations of the draws that are poses [mm]."""
        return [depth for depth in self.penetration_mm if depth is not None]


Records = Sequence[SamplingRecord]


def verified_and_seconds(records: Records, *, without: tuple[str, ...] = (LOADING,)) -> Float[np.ndarray, "record 2"]:
    """Return (verified draws, seconds of all stages but some) of each record; a failed one has neither."""
    spent = [sum(value for stage, value in each.seconds.items() if stage not in without) for each in records]
    return np.array([[float(each.verified), seconds] for each, seconds in zip(records, spent, strict=True)])


def _top_of(k: int) -> Callable[[Records], Estimate | None]:
    """Share of the objects whose best of k draws succeeds, mean over all choices of k; None where there are fewer."""

    def found(records: Records) -> Estimate | None:
        if min(each.num for each in records) < k:
            return None
        return mean_estimate([chance_of_top(each.success, k) if each.success else 0.0 for each in records])

    return found


def _own_first(record: SamplingRecord) -> bool:
    """Whether the sampler's own first choice, before verification, succeeds."""
    return any(ok for ok, rank in zip(record.success, record.own_rank, strict=True) if rank == 0)


def _deep_quantile(records: Records) -> float | None:
    every = [depth for each in records if each.status == "done" for depth in each.depths]
    return float(np.quantile(every, DEEP_QUANTILE)) if every else None


def _speed(records: Records) -> Estimate:
    return estimate_of_sums(verified_and_seconds(records), ratio)


def _rejected(records: Records) -> dict[str, int]:
    """Draws by reason; those of failed objects under a name of their own."""
    counts: Counter[str] = Counter()
    for each in records:
        counts.update(each.rejected if each.status == "done" else {"object failed": each.num})
    return dict(counts.most_common())


def _seconds(records: Records) -> dict[str, float]:
    """Mean of each stage over the trials that were done."""
    done, total = [each for each in records if each.status == "done"], Counter[str]()
    for each in done:
        total.update(each.seconds)
    return {stage: value / len(done) for stage, value in total.items()}


METRICS = (
    OBJECTS,
    FAILED,
    Metric("draws", lambda records: sum(each.num for each in records), "draws", 0),
    Metric("single", share(lambda each: sum(each.success) / each.num), "single"),  # of all draws
    Metric("single_robust", share(lambda each: sum(each.robust) / each.num), "single robust"),
    Metric("first", share(_own_first), "first"),
    Metric("top_of_8", _top_of(8), "top of 8"),
    Metric("top_of_32", _top_of(32), "top of 32"),
    Metric("top", share(lambda each: any(each.success[:1])), "top-ranked"),
    Metric("top_robust", share(lambda each: any(each.robust[:1])), "top-ranked robust"),
    Metric("any", share(lambda each: any(each.success)), "any of n"),
    Metric("verified_per_second", _speed, "verified/s", 1),
    Metric("clean", share(lambda each: sum(depth <= 1e3 * PENETRATION_LIMIT for depth in each.depths) / each.num)),
    # Penetrations and margins: the median over an object's draws, mean over objects.
    Metric("depth_mm", mean(lambda each: float(np.median(each.depths)) if each.depths else None), form=2),
    Metric("depth_95_mm", _deep_quantile, form=2),
    Metric("margin", mean(lambda each: float(np.median(each.force_margin))), form=2),
    Metric("top_margin", mean(lambda each: each.force_margin[0]), form=2),
    Metric("joint_diversity", mean(lambda each: each.joint_diversity), form=2),
    Metric("contact_diversity", mean(lambda each: each.contact_diversity), form=2),
    Metric(
        "diverse_objects",
        lambda records: sum(each.joint_diversity is not None for each in records if each.status == "done"),
        form=0,
    ),
    Metric("seconds_per_verified", lambda records: _speed(records).inverse(), form=2),
    Metric("rejected", _rejected, "Why draws were rejected", "counts"),
    Metric("seconds", _seconds, form=2),
)
DISTURBED = named(METRICS, "single", "top", "any")


def measure_disturbed(records: Records) -> list[Measured]:
    """Return `DISTURBED` by scene, method and setting; draws of failed objects count as none that succeeds."""
    found = []
    for group in by_scene_and_method(records).values():
        settings = dict.fromkeys(setting for each in group for setting in each.swept)
        for setting in [AS_DRAWN, *settings] if settings else []:
            there = [replace(each, success={AS_DRAWN: each.success, **each.swept}.get(setting, [])) for each in group]
            found += [{**row, "setting": setting} for row in measure(there, DISTURBED)]
    return found
