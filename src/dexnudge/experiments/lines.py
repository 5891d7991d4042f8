"""The figures of a scene and a method over all attempted objects, from the rows of an experiment."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.rows import Row
from dexnudge.experiments.statistics import (
    Estimate,
    chance_of_top,
    estimate_of_sums,
    mean_estimate,
    mean_of_known,
    ratio,
)
from dexnudge.verification.criteria import PENETRATION_LIMIT, ROBUST_MARGIN

BEST_OF = (8, 32)  # numbers of draws of which a robot may take the best, as far as there are that many
DEEP_QUANTILE = 0.95  # of the worst depth: what the worst of twenty draws reaches
LOADING = "load"  # the stage that is not the method's


@dataclass(frozen=True)
class Line:
    """One scene and method over all attempted objects.

    Attributes:
        objects, failed: attempted, and those of them that could not be read or did not fit the scene.
        samples: draws attempted, those of failed objects included: the denominator of all rates over draws.
        clean: share of all draws without penetration above 1 mm, whatever else became of them.
        single: share of all draws that succeed.
        single_robust: share of all draws that succeed with a force margin of at least 1.5.
        first: share of objects whose first draw in the sampler's own order, before verification, succeeds.
        best_of, best_of_robust: number of draws k -> share of objects whose top-ranked of k draws succeeds, and does so
            with a margin of at least 1.5; the mean over all choices of k among the draws.
        top: share of objects whose top-ranked draw, the one that a robot would use, succeeds.
        top_robust: the same with a force margin of at least 1.5.
        any: share of objects with at least one draw that succeeds.
        depth_mm: worst depth [mm], median over an object's draws that are poses, mean over objects; None without any.
        depth_95_mm: 95th percentile of the worst depth of every draw that is a pose [mm]; None where there is none.
        margin: force margin, median over an object's draws, mean over objects. top_margin: that of the top-ranked draw,
            mean over objects. Objects that failed have neither; None where all did.
        joint_diversity [rad], contact_diversity [half lengths]: of verified draws, mean over the `spread_objects` that have
            enough of them.
        rejected: draws by reason; those of failed objects under "object failed".
        seconds: mean per sampled row, by stage.
        verified_per_second: over the time of all stages but loading.
    """

    scene: str
    method: str
    objects: int
    failed: int
    samples: int
    clean: Estimate
    single: Estimate
    single_robust: Estimate
    first: Estimate
    best_of: dict[int, Estimate]
    best_of_robust: dict[int, Estimate]
    top: Estimate
    top_robust: Estimate
    any: Estimate
    depth_mm: Estimate | None
    depth_95_mm: float | None
    margin: Estimate | None
    top_margin: Estimate | None
    joint_diversity: Estimate | None
    contact_diversity: Estimate | None
    spread_objects: int
    rejected: dict[str, int]
    seconds: dict[str, float]
    verified_per_second: Estimate


def summarise(rows: Sequence[Row]) -> list[Line]:
    """One line for each scene and method, in the order of their first rows."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.method), []).append(row)
    return [_line(scene, method, group) for (scene, method), group in groups.items()]


def _line(scene: str, method: str, rows: list[Row]) -> Line:
    sampled = [row for row in rows if row.status == "sampled"]
    rejected: Counter[str] = Counter()
    seconds: Counter[str] = Counter()
    for row in rows:
        rejected.update(row.rejected if row.status == "sampled" else {"object failed": row.num})
    for row in sampled:
        seconds.update(row.seconds)
    depths = [[depth for depth in row.penetration_mm if depth is not None] for row in sampled]
    return Line(
        scene=scene,
        method=method,
        objects=len(rows),
        failed=len(rows) - len(sampled),
        samples=sum(row.num for row in rows),
        clean=mean_estimate([sum(map(_clean, row.penetration_mm)) / row.num for row in rows]),
        single=mean_estimate([sum(row.success) / row.num for row in rows]),
        single_robust=mean_estimate([sum(robust(row)) / row.num for row in rows]),
        first=mean_estimate([_first(row) for row in rows]),
        best_of=_best_of(rows, lambda row: row.success),
        best_of_robust=_best_of(rows, robust),
        top=mean_estimate([float(any(row.success[:1])) for row in rows]),
        top_robust=mean_estimate([float(any(robust(row)[:1])) for row in rows]),
        any=mean_estimate([float(any(row.success)) for row in rows]),
        depth_mm=mean_of_known([float(np.median(each)) for each in depths if each]),
        depth_95_mm=_quantile([depth for each in depths for depth in each], DEEP_QUANTILE),
        margin=mean_of_known([float(np.median(row.force_margin)) for row in sampled]),
        top_margin=mean_of_known([row.force_margin[0] for row in sampled]),
        joint_diversity=mean_of_known(row.joint_diversity for row in sampled),
        contact_diversity=mean_of_known(row.contact_diversity for row in sampled),
        spread_objects=sum(row.joint_diversity is not None for row in sampled),
        rejected=dict(rejected.most_common()),
        seconds={stage: value / len(sampled) for stage, value in seconds.items()},
        verified_per_second=estimate_of_sums(verified_and_seconds(rows), ratio),
    )


def robust(row: Row) -> list[bool]:
    """Which draws succeed with a force margin of at least 1.5."""
    return [ok and margin >= ROBUST_MARGIN for ok, margin in zip(row.success, row.force_margin, strict=True)]


def verified_and_seconds(rows: Sequence[Row], *, without: tuple[str, ...] = (LOADING,)) -> Float[np.ndarray, "row 2"]:
    """(verified draws, seconds of all stages but some) of each row; a failed row has neither."""
    spent = [sum(value for stage, value in row.seconds.items() if stage not in without) for row in rows]
    return np.array([[float(sum(row.success)), seconds] for row, seconds in zip(rows, spent, strict=True)])


def _best_of(rows: list[Row], good: Callable[[Row], list[bool]]) -> dict[int, Estimate]:
    """For each number in `BEST_OF` that no row falls short of.

    Rows hold their draws in ranked order; a failed row has none that is good.
    """
    least = min(row.num for row in rows)
    return {
        k: mean_estimate([chance_of_top(good(row), k) if row.success else 0.0 for row in rows])
        for k in BEST_OF
        if k <= least
    }


def _clean(depth_mm: float | None) -> bool:
    return depth_mm is not None and depth_mm <= 1e3 * PENETRATION_LIMIT


def _first(row: Row) -> float:
    return float(any(ok for ok, rank in zip(row.success, row.own_rank, strict=True) if rank == 0))


def _quantile(values: list[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None
