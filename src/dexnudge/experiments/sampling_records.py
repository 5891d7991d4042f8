"""The records of sampling trials, and the figures of many: what single draws, the top-ranked one and any of them reach."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.disturbances import AS_DRAWN, setting_text
from dexnudge.experiments.metrics import FAILED, OBJECTS, Measured, Metric, by_scene_and_method, named
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.statistics import (
    Estimate,
    chance_of_top,
    estimate_of_sums,
    mean_estimate,
    mean_of_known,
    ratio,
)
from dexnudge.verification.criteria import PENETRATION_LIMIT, ROBUST_MARGIN

LOADING = "load"  # the stage that is not the method's
DEEP_QUANTILE = 0.95  # of the worst depth: what the worst of twenty draws reaches


@dataclass(frozen=True, kw_only=True)
class SamplingRecord(TrialRecord):
    """The verified draws of a trial; lists are in ranked order: verified ones first, best first.

    Attributes:
        success: of each draw. force_margin: of each draw.
        penetration_mm: the deepest of the three penetrations of each draw; null where the draw is no pose.
        own_rank: place of each draw in the sampler's own order, before verification.
        joint_diversity [rad], contact_diversity [half lengths of the object]: of the verified draws; null where fewer
            than two are.
        swept: success of each draw at other frictions and masses, by `disturbances.setting_name`; empty where the
            experiment does not ask for it.
        rejected: draws that did not succeed, by reason.
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

    @property
    def robust(self) -> list[bool]:
        """Which draws succeed with a force margin of at least `ROBUST_MARGIN`."""
        return [ok and margin >= ROBUST_MARGIN for ok, margin in zip(self.success, self.force_margin, strict=True)]


Records = Sequence[SamplingRecord]


def verified_and_seconds(records: Records, *, without: tuple[str, ...] = (LOADING,)) -> Float[np.ndarray, "record 2"]:
    """Return (verified draws, seconds of all stages but some) of each record; a failed one has neither."""
    spent = [sum(value for stage, value in each.seconds.items() if stage not in without) for each in records]
    return np.array([[float(each.verified), seconds] for each, seconds in zip(records, spent, strict=True)])


def _share(good: Callable[[SamplingRecord], Sequence[bool]]) -> Callable[[Records], Estimate]:
    """Share of all draws; every object has the same number of them."""
    return lambda records: mean_estimate([sum(good(each)) / each.num for each in records])


def _top(good: Callable[[SamplingRecord], Sequence[bool]]) -> Callable[[Records], Estimate]:
    """Share of the objects whose top-ranked draw is good."""
    return lambda records: mean_estimate([float(any(good(each)[:1])) for each in records])


def _top_of(k: int) -> Callable[[Records], Estimate | None]:
    """Share of the objects whose best of k draws succeeds, mean over all choices of k; None where there are fewer."""

    def found(records: Records) -> Estimate | None:
        if min(each.num for each in records) < k:
            return None
        return mean_estimate([chance_of_top(each.success, k) if each.success else 0.0 for each in records])

    return found


def _done(records: Records) -> list[SamplingRecord]:
    return [each for each in records if each.status == "done"]


def _clean(record: SamplingRecord) -> list[bool]:
    return [depth is not None and depth <= 1e3 * PENETRATION_LIMIT for depth in record.penetration_mm]


def _own_first(record: SamplingRecord) -> list[bool]:
    """The success of the sampler's own first draw, and nothing else."""
    return [ok for ok, rank in zip(record.success, record.own_rank, strict=True) if rank == 0]


def _depths(records: Records) -> list[list[float]]:
    return [[depth for depth in each.penetration_mm if depth is not None] for each in _done(records)]


def _median_depth(records: Records) -> Estimate | None:
    return mean_of_known(float(np.median(depths)) for depths in _depths(records) if depths)


def _deep_quantile(records: Records) -> float | None:
    every = [depth for depths in _depths(records) for depth in depths]
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
    done, total = _done(records), Counter[str]()
    for each in done:
        total.update(each.seconds)
    return {stage: value / len(done) for stage, value in total.items()}


RATES = (
    OBJECTS,
    FAILED,
    Metric("draws", "draws", lambda records: sum(each.num for each in records), 0),
    Metric("single", "single", _share(lambda each: each.success), about="share of all draws that succeed"),
    Metric("single_robust", "single robust", _share(lambda each: each.robust)),
    Metric("first", "first", _top(_own_first), about="the sampler's own first choice, before verification"),
    Metric("top_of_8", "top of 8", _top_of(8), about="best of 8 draws, mean over all choices of 8"),
    Metric("top_of_32", "top of 32", _top_of(32)),
    Metric("top", "top-ranked", _top(lambda each: each.success), about="objects whose best ranked draw succeeds"),
    Metric("top_robust", "top-ranked robust", _top(lambda each: each.robust)),
    Metric("any", "any of n", lambda records: mean_estimate([float(any(each.success)) for each in records])),
    Metric("verified_per_second", "verified/s", _speed, 1),
)
MEASURES = (
    Metric("clean", "no penetration > 1 mm, %", _share(_clean)),
    Metric(
        "depth_mm",
        "worst depth, mm",
        _median_depth,
        2,
        "the deepest of object, surroundings and hand itself, median over an object's draws, mean over objects",
    ),
    Metric("depth_95_mm", "95th percentile, mm", _deep_quantile, 2, "of the worst depth, over all draws"),
    Metric(
        "margin",
        "margin",
        lambda records: mean_of_known(float(np.median(each.force_margin)) for each in _done(records)),
        2,
        "force margin, median over an object's draws, mean over objects",
    ),
    Metric(
        "top_margin",
        "margin of top-ranked",
        lambda records: mean_of_known(each.force_margin[0] for each in _done(records)),
        2,
    ),
    Metric(
        "joint_diversity",
        "joint diversity, rad",
        lambda records: mean_of_known(each.joint_diversity for each in _done(records)),
        2,
        "standard deviation over the verified draws, mean over the joints",
    ),
    Metric(
        "contact_diversity",
        "contact diversity, half lengths",
        lambda records: mean_of_known(each.contact_diversity for each in _done(records)),
        2,
        "mean distance of the fingertips' contacts with the object from their mean",
    ),
    Metric(
        "diverse_objects",
        "objects with a diversity",
        lambda records: sum(each.joint_diversity is not None for each in _done(records)),
        0,
        "those with at least two verified draws",
    ),
    Metric("seconds_per_verified", "s per verified", lambda records: _speed(records).inverse(), 2),
)
REJECTED = Metric("rejected", "rejected", _rejected, 0)
SECONDS = Metric("seconds", "seconds", _seconds, 2)
ABOUT_DISTURBED = (
    "The same draws verified again where one quantity is multiplied; nothing is drawn anew. Top-ranked: the one that was "
    "ranked first at the values for which it was drawn."
)
DISTURBED = named(RATES, "single", "top", "any")


def measure_disturbed(records: Records) -> list[Measured]:
    """Return `DISTURBED` by scene, method and setting; draws of failed objects count as none that succeeds."""
    found = []
    for (scene, method), group in by_scene_and_method(records).items():
        settings = list(dict.fromkeys(setting for each in group for setting in each.swept))
        for setting in [AS_DRAWN, *settings] if settings else []:
            success = [each.success if setting == AS_DRAWN else each.swept.get(setting, []) for each in group]
            figures = {
                "single": mean_estimate([sum(ok) / each.num for ok, each in zip(success, group, strict=True)]),
                "top": mean_estimate([float(any(ok[:1])) for ok in success]),
                "any": mean_estimate([float(any(ok)) for ok in success]),
            }
            found.append({"scene": scene, "method": method, "setting": setting_text(setting), **figures})
    return found
