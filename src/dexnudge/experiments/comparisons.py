"""Methods beside each other at equal time, beside the numbers of the paper, and before and after their projection."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.metrics import Measured, Metric, by_scene_and_method, named
from dexnudge.experiments.sampling_records import LOADING, METRICS, Records, verified_and_seconds
from dexnudge.experiments.statistics import Estimate, estimate_of_sums, mean_estimate, ratio
from dexnudge.experiments.tables import Table
from dexnudge.hands.hand import Hand
from dexnudge.sampling.methods import Method
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import PENETRATION_LIMIT
from dexnudge.verification.verdicts import Verdicts, verify

STEERED_NOISE, RANDOM_START = "steered_noise", "random_start_projection"
MAIN = (STEERED_NOISE, RANDOM_START)  # ours, and no prior at all
PREPARING = "prepare"  # the stage that all methods need alike, once per scene

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
    "The paper has one outcome for each of its objects, in its own scenes and by a criterion without a formula."
)


def equal_time(records: Records, budget: str = STEERED_NOISE, baseline: str = RANDOM_START) -> list[Measured]:
    """Return `EQUAL_TIME` of each scene and method, in the time of the method `budget` and beside `baseline`.

    All methods must have the same objects in a scene; nothing where one of the two methods is missing.
    """
    found = []
    groups = {key: sorted(group, key=lambda each: each.object) for key, group in by_scene_and_method(records).items()}
    for (scene, method), mine in groups.items():
        compared = (mine, groups.get((scene, baseline)), groups.get((scene, budget)))
        if all(compared):
            assert len({tuple(each.object for each in side or ()) for side in compared}) == 1
            found.append({"scene": scene, "method": method, **{each.name: each.of(compared) for each in EQUAL_TIME}})
    return found


def paper_table(parts: Mapping[str, Sequence[Measured]], number: int) -> Table:
    """Return Table I or II of the paper with our rates [%]; `parts`: how hand or model differs -> its figures."""
    if number == 1:
        paper: Mapping[str, Mapping[str, float | tuple[float, float]]] = TABLE_1
        header, rates = ["the paper"], named(METRICS, "single", "first", "top", "top_robust")
        ours = [metric.header for metric in rates]
    else:
        paper = TABLE_2
        header, rates = ["the paper: non-penetration", "feasibility"], named(METRICS, "clean", "single", "top")
        ours = [f"no penetration > {1e3 * PENETRATION_LIMIT:g} mm", *(metric.header for metric in rates[1:])]
    rows = []
    for scene in dict.fromkeys(row["scene"] for measured in parts.values() for row in measured):
        for method, success in paper.items():
            theirs = np.atleast_1d(success[scene]).tolist() if scene in success else [""] * len(header)
            rows += [
                [scene, method, part, *theirs, *(metric.text(row[metric.name]) for metric in rates)]
                for part, measured in parts.items()
                for row in measured
                if (row["scene"], row["method"]) == (scene, method)
            ]
    return Table(["scene", "method", "hand and model", *header, *ours], rows, labels=3)


# The figures of `equal_time` are of three lists of records of the same objects: a method's, the baseline's, the budget's.
Compared = Sequence[Records]


def _spent(records: Records) -> list[float]:
    """Seconds of the draws of each record, loading and preparing left out."""
    return verified_and_seconds(records, without=(LOADING, PREPARING))[:, 1].tolist()


def _verified_in_that_time(compared: Compared) -> Estimate:
    """Mean verified draws of an object: draws are independent, so counts scale with time."""
    verified = [each.verified for each in compared[0]]
    times = zip(verified, _spent(compared[0]), _spent(compared[2]), strict=True)
    return mean_estimate([count * given / own if own else 0.0 for count, own, given in times])


def _per_second(*without: str) -> Callable[[Compared], Estimate]:
    return lambda compared: estimate_of_sums(verified_and_seconds(compared[0], without=without), ratio)


def _speed_up(*without: str) -> Callable[[Compared], Estimate]:
    """Verified draws per second over those of the baseline."""

    def quotient(sums: Float[np.ndarray, "resample 4"]) -> Float[np.ndarray, " resample"]:
        verified, seconds, theirs, own = sums.T
        return ratio(np.stack([verified * own, seconds * theirs], axis=1))

    return lambda compared: estimate_of_sums(
        np.concatenate([verified_and_seconds(each, without=without) for each in compared[:2]], axis=1), quotient
    )


JOINT, CONTACT = named(METRICS, "joint_diversity", "contact_diversity")
EQUAL_TIME = (
    Metric("seconds", lambda compared: mean_estimate(_spent(compared[2])), form=2),
    Metric("verified", _verified_in_that_time, "verified in that time", 1),
    Metric("prepared_per_second", _per_second(LOADING, PREPARING), "verified/s", 1),
    Metric("prepared_speed_up", _speed_up(LOADING, PREPARING), "ratio", 1),
    Metric("per_second", _per_second(LOADING), "verified/s with preparation", 1),
    Metric("speed_up", _speed_up(LOADING), "ratio with preparation", 1),
    Metric("joint_diversity", lambda compared: JOINT.of(compared[0]), "joint diversity, rad", 2),
    Metric("contact_diversity", lambda compared: CONTACT.of(compared[0]), "contact diversity, half lengths", 2),
)


def projection_effect(
    sampler: Sampler, hand: Hand, scene: Scene, *, num: int, seed: int, method: Method
) -> dict[str, dict[str, float | int]]:
    """Return the figures of draws "before" and "after" the projection; nothing for a method without one."""
    if method.projection is None:
        return {}
    draws = sampler.draw(prepare(scene, device=sampler.device), num=num, seed=seed, method=method)
    stages = {"before": draws.unprojected, "after": draws.q}
    return {name: stage_figures(verify(scene, hand, q)) for name, q in stages.items()}


def stage_figures(verdicts: Verdicts) -> dict[str, float | int]:
    """Return how many are verified, and means over all: links in contact, force margin, deepest penetration [mm].

    A hand that stands in the object touches it all around, so its margin says little: read it with the penetration.
    """
    deepest = verdicts.deepest_penetration
    return {
        "verified": int(verdicts.success.sum()),
        "contact_links": float(np.mean([len(links) for links in verdicts.contact_links])),
        "force_margin": float(verdicts.force_margin.mean()),
        "force_margin_median": float(np.median(verdicts.force_margin)),
        "penetration_mm": 1e3 * float(np.nanmean(deepest)) if np.isfinite(deepest).any() else 0.0,
    }
