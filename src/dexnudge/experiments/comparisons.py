"""Methods beside each other: at equal time on the wall clock, and beside the numbers of the paper."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.metrics import Measured, Metric, named
from dexnudge.experiments.sampling_records import (
    LOADING,
    MEASURES,
    RATES,
    Records,
    SamplingRecord,
    verified_and_seconds,
)
from dexnudge.experiments.statistics import estimate_of_sums, mean_estimate, mean_of_known, ratio
from dexnudge.experiments.tables import Table, method_name

STEERED_NOISE, RANDOM_START = "steered_noise", "random_start_projection"
MAIN = (STEERED_NOISE, RANDOM_START)  # ours, and no prior at all
PREPARING = "prepare"  # the stage that all methods need alike, once per scene
DIVERSITY = named(MEASURES, "joint_diversity", "contact_diversity")
EQUAL_TIME = (  # the columns of `equal_time`, which computes them
    Metric("verified", "verified in that time", len, 1),
    Metric("prepared_per_second", "verified/s", len, 1),
    Metric("prepared_speed_up", "ratio", len, 1),
    Metric("per_second", "verified/s with preparation", len, 1),
    Metric("speed_up", "ratio with preparation", len, 1),
    *DIVERSITY,
)
ABOUT_EQUAL_TIME = (
    "How many draws each method verifies in the time that dexnudge takes for its draws of one object once the scene is "
    "prepared: counts are scaled to that time, since draws are independent. Ratio: verified draws per second over those "
    "of random start + projection; none where that verifies nothing. Diversities are those of the verified draws."
)

PAPER_SUCCESS = {  # Table I [%]: scene -> the paper's method
    "table": 73.2,
    "layers": 78.0,
    "shelf": 63.4,
}
TABLE_1 = {  # method of ours -> scene -> success [%] of what it stands for in the paper: DGA, and the paper's method
    "grasp_projection": {"table": 31.7, "layers": 39.0, "shelf": 0.0},
    "paper": PAPER_SUCCESS,
    STEERED_NOISE: PAPER_SUCCESS,
}
_GUIDANCE_ONLY = {"table": (26.8, 0.0), "layers": (0.0, 0.0), "shelf": (24.4, 0.0)}
_PROJECTED = {"table": (100.0, 73.2), "layers": (100.0, 78.0), "shelf": (73.2, 63.4)}
TABLE_2 = {  # method of ours -> scene -> (non-penetration, manipulation feasibility) [%] in the paper
    "paper_guidance_only": _GUIDANCE_ONLY,
    "paper": _PROJECTED,
    "guidance_only": _GUIDANCE_ONLY,
    STEERED_NOISE: _PROJECTED,
}
ABOUT_PAPER = (
    "The paper gives one outcome for each of its objects, in its own scenes and by a criterion without a formula: its "
    "columns orient, and no more."
)


def equal_time(records: Records, budget: str = STEERED_NOISE, baseline: str = RANDOM_START) -> list[Measured]:
    """Return the figures of each scene and method in the time of the method `budget`, and beside those of `baseline`.

    seconds: mean time of the budget's draws for one object, loading and preparing left out. verified: mean verified draws
    of an object in that time; draws are independent of each other, so a method's count in another time is its own count
    times the ratio of the times. per_second, prepared_per_second: verified draws per second, with the scene's preparation
    and once it is made; speed_up, prepared_speed_up: their ratios to those of the baseline. All methods must have the same
    objects in a scene; nothing where one of the two methods is missing.
    """
    found = []
    for scene in dict.fromkeys(each.scene for each in records):
        by_method: dict[str, list[SamplingRecord]] = {}
        for each in sorted((each for each in records if each.scene == scene), key=lambda each: each.object):
            by_method.setdefault(each.method, []).append(each)
        for method in dict.fromkeys(each.method for each in records if each.scene == scene):
            if {budget, baseline} <= set(by_method):
                figures = _compared(by_method[method], by_method[baseline], by_method[budget])
                found.append({"scene": scene, "method": method, **figures})
    return found


def paper_table(parts: Mapping[str, Sequence[Measured]], number: int) -> Table:
    """Return Table I or II of the paper with our rates [%]; `parts`: how hand or model differs -> its figures."""
    if number == 1:
        paper: Mapping[str, Mapping[str, float | tuple[float, float]]] = TABLE_1
        header, rates = ["the paper"], named(RATES, "single", "first", "top", "top_robust")
    else:
        paper = TABLE_2
        header = ["the paper: non-penetration", "feasibility"]
        rates = named([*RATES, *MEASURES], "clean", "single", "top")
    rows = []
    for scene in dict.fromkeys(row["scene"] for measured in parts.values() for row in measured):
        for method, success in paper.items():
            theirs = np.atleast_1d(success[scene]).tolist() if scene in success else [""] * len(header)
            for part, measured in parts.items():
                for row in measured:
                    if (row["scene"], row["method"]) == (scene, method):
                        ours = [metric.text(row[metric.name]) for metric in rates]
                        rows.append([scene, method_name(method), part, *theirs, *ours])
    return Table(["scene", "method", "hand and model", *header, *(metric.header for metric in rates)], rows, labels=3)


def _compared(mine: Records, theirs: Records, limit: Records) -> Measured:
    assert [each.object for each in mine] == [each.object for each in theirs] == [each.object for each in limit]
    whole, prepared = (
        np.concatenate([verified_and_seconds(mine, without=left), verified_and_seconds(theirs, without=left)], axis=1)
        for left in ((LOADING,), (LOADING, PREPARING))
    )
    given = verified_and_seconds(limit, without=(LOADING, PREPARING))[:, 1]
    in_that_time = [
        verified * time / own if own else 0.0
        for (verified, own), time in zip(prepared[:, :2].tolist(), given.tolist(), strict=True)
    ]
    return {
        "seconds": mean_estimate(given.tolist()),
        "verified": mean_estimate(in_that_time),
        "per_second": estimate_of_sums(whole[:, :2], ratio),
        "prepared_per_second": estimate_of_sums(prepared[:, :2], ratio),
        "speed_up": estimate_of_sums(whole, _speed_up),
        "prepared_speed_up": estimate_of_sums(prepared, _speed_up),
        **{metric.name: mean_of_known(getattr(each, metric.name) for each in mine) for metric in DIVERSITY},
    }


def _speed_up(sums: Float[np.ndarray, "resample 4"]) -> Float[np.ndarray, " resample"]:
    verified, seconds, theirs, own = sums.T
    return ratio(np.stack([verified * own, seconds * theirs], axis=1))
