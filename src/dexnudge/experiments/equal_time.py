"""Methods given the same time on the wall clock."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.lines import LOADING, verified_and_seconds
from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.method_names import method_name
from dexnudge.experiments.rows import Row
from dexnudge.experiments.statistics import Estimate, estimate_of_sums, mean_estimate, mean_of_known, ratio

PREPARING = "prepare"  # the stage that all methods need alike, once per scene


@dataclass(frozen=True)
class EqualTime:
    """A method in one scene, over all attempted objects, in the time of one method and beside the yield of another.

    Attributes:
        method: what is measured. budget: the method whose time is given. baseline: what it is compared with.
        seconds: mean time of the budget's draws for one object, loading and preparing left out.
        verified: mean verified draws of an object in that time. Draws are independent of each other, so a method's count
            in another time is its own count times the ratio of the times.
        per_second, prepared_per_second: verified draws per second, with the scene's preparation and once it is made.
        speed_up, prepared_speed_up: their ratios to those of the baseline.
        joint_diversity [rad], contact_diversity [half lengths]: of verified draws; None where no object has one.
    """

    scene: str
    method: str
    budget: str
    baseline: str
    seconds: Estimate
    verified: Estimate
    per_second: Estimate
    prepared_per_second: Estimate
    speed_up: Estimate
    prepared_speed_up: Estimate
    joint_diversity: Estimate | None
    contact_diversity: Estimate | None


def equal_time(rows: Sequence[Row], budget: str, baseline: str) -> list[EqualTime]:
    """One entry for each scene and method, in the order of the rows; all methods must have the same objects there."""
    found = []
    for scene in dict.fromkeys(row.scene for row in rows):
        by_method: dict[str, list[Row]] = {}
        for row in sorted((row for row in rows if row.scene == scene), key=lambda row: row.object):
            by_method.setdefault(row.method, []).append(row)
        for method in dict.fromkeys(row.method for row in rows if row.scene == scene):
            mine, theirs, limit = (by_method[name] for name in (method, baseline, budget))
            assert [row.object for row in mine] == [row.object for row in theirs] == [row.object for row in limit]
            found.append(_compared(mine, theirs, limit))
    return found


def equal_time_table(found: Sequence[EqualTime]) -> str:
    """The comparisons as a table."""
    header = ["scene", "method", "verified in that time", "verified/s", "ratio"]
    header += [
        "verified/s with preparation",
        "ratio with preparation",
        "joint spread, rad",
        "contact spread, half lengths",
    ]
    rows = [
        [
            each.scene,
            method_name(each.method),
            *(e.text(1) for e in (each.verified, each.prepared_per_second, each.prepared_speed_up)),
            *(e.text(1) for e in (each.per_second, each.speed_up)),
            *(e.text() if e else "" for e in (each.joint_diversity, each.contact_diversity)),
        ]
        for each in found
    ]
    return markdown_table(header, rows)


def _compared(mine: Sequence[Row], theirs: Sequence[Row], limit: Sequence[Row]) -> EqualTime:
    whole, prepared = (
        np.concatenate([verified_and_seconds(mine, without=left), verified_and_seconds(theirs, without=left)], axis=1)
        for left in ((LOADING,), (LOADING, PREPARING))
    )
    given = verified_and_seconds(limit, without=(LOADING, PREPARING))[:, 1]
    return EqualTime(
        scene=mine[0].scene,
        method=mine[0].method,
        budget=limit[0].method,
        baseline=theirs[0].method,
        seconds=mean_estimate(given.tolist()),
        verified=mean_estimate(_in_the_time_of(prepared, given)),
        per_second=estimate_of_sums(whole[:, :2], ratio),
        prepared_per_second=estimate_of_sums(prepared[:, :2], ratio),
        speed_up=estimate_of_sums(whole, _speed_up),
        prepared_speed_up=estimate_of_sums(prepared, _speed_up),
        joint_diversity=mean_of_known(row.joint_diversity for row in mine),
        contact_diversity=mean_of_known(row.contact_diversity for row in mine),
    )


def _in_the_time_of(columns: Float[np.ndarray, "object 4"], given: Float[np.ndarray, " object"]) -> list[float]:
    """The count of columns (verified, seconds, ...) in the given seconds; none where nothing was drawn."""
    counts = zip(columns[:, :2].tolist(), given.tolist(), strict=True)
    return [verified * time / own if own else 0.0 for (verified, own), time in counts]


def _speed_up(sums: Float[np.ndarray, "resample 4"]) -> Float[np.ndarray, " resample"]:
    verified, seconds, theirs, own = sums.T
    return ratio(np.stack([verified * own, seconds * theirs], axis=1))
