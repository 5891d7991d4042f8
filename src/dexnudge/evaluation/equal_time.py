"""Two methods given the same time on the wall clock."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.evaluation.estimate import Estimate, estimate_of_sums, mean_estimate, ratio
from dexnudge.evaluation.lines import LOADING, verified_and_seconds
from dexnudge.evaluation.markdown import markdown_table
from dexnudge.evaluation.rows import Row

PREPARING = "prepare"  # the stage that both methods need alike, once per scene


@dataclass(frozen=True)
class EqualTime:
    """A method against a baseline in one scene, over all attempted objects.

    Attributes:
        seconds: mean time of the method for one object's draws, loading and preparing left out.
        verified, baseline_verified: mean verified draws of an object in that time. The baseline's draws are independent
            of each other, so its count in another time is its own count times the ratio of the times.
        per_second, baseline_per_second: verified draws per second, the scene's preparation included.
        speed_up: ratio of the two.
        prepared_speed_up: the same once the scene is prepared.
    """

    scene: str
    method: str
    baseline: str
    seconds: Estimate
    verified: Estimate
    baseline_verified: Estimate
    per_second: Estimate
    baseline_per_second: Estimate
    speed_up: Estimate
    prepared_speed_up: Estimate


def equal_time(rows: Sequence[Row], method: str, baseline: str) -> list[EqualTime]:
    """One comparison for each scene; both methods must have the same objects there."""
    found = []
    for scene in dict.fromkeys(row.scene for row in rows):
        mine, theirs = (
            sorted((row for row in rows if (row.scene, row.method) == (scene, name)), key=lambda row: row.object)
            for name in (method, baseline)
        )
        assert [row.object for row in mine] == [row.object for row in theirs]
        whole, prepared = (
            np.concatenate(
                [verified_and_seconds(mine, without=left), verified_and_seconds(theirs, without=left)], axis=1
            )
            for left in ((LOADING,), (LOADING, PREPARING))
        )
        found.append(
            EqualTime(
                scene=scene,
                method=method,
                baseline=baseline,
                seconds=mean_estimate(prepared[:, 1].tolist()),
                verified=mean_estimate(prepared[:, 0].tolist()),
                baseline_verified=mean_estimate(_in_the_time_of(prepared)),
                per_second=estimate_of_sums(whole[:, :2], ratio),
                baseline_per_second=estimate_of_sums(whole[:, 2:], ratio),
                speed_up=estimate_of_sums(whole, _speed_up),
                prepared_speed_up=estimate_of_sums(prepared, _speed_up),
            )
        )
    return found


def equal_time_table(found: Sequence[EqualTime]) -> str:
    """The comparisons as a table."""
    header = ["scene", "method", "against", "s per object", "verified", "against, same time"]
    header += ["verified/s", "against", "ratio", "ratio, scene prepared"]
    rows = [
        [
            each.scene,
            each.method,
            each.baseline,
            *(e.text() for e in (each.seconds, each.verified, each.baseline_verified)),
            *(e.text() for e in (each.per_second, each.baseline_per_second, each.speed_up, each.prepared_speed_up)),
        ]
        for each in found
    ]
    return markdown_table(header, rows, names=3)


def _in_the_time_of(columns: Float[np.ndarray, "object 4"]) -> list[float]:
    """Of columns (verified, seconds, baseline verified, baseline seconds): the baseline's count in the others' seconds."""
    return [theirs * time / own if own else 0.0 for _, time, theirs, own in columns.tolist()]


def _speed_up(sums: Float[np.ndarray, "resample 4"]) -> Float[np.ndarray, " resample"]:
    verified, seconds, theirs, own = sums.T
    return ratio(np.stack([verified * own, seconds * theirs], axis=1))
