"""Sampling: the draws for an object in a scene, verified."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.comparisons import EQUAL_TIME, equal_time
from dexnudge.experiments.disturbances import verify_disturbed
from dexnudge.experiments.metrics import Metric
from dexnudge.experiments.sampling_records import DISTURBED, METRICS, SamplingRecord, measure_disturbed
from dexnudge.experiments.tables import metric_table
from dexnudge.experiments.trial import DrawnTrial, Section, TrialSampler
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.results.samples import Samples
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import ROBUST_MARGIN

SEVERAL = 2  # fewer configurations, or contact places, have no diversity
ABOUT_EQUAL_TIME = (
    "Verified draws in the time that dexnudge takes for an object once the scene is prepared: counts are scaled to it, "
    "since draws are independent. Ratio: verified per second over that of random start + projection."
)
ABOUT_DISTURBED = "The same draws verified again where one quantity is multiplied; ranked as they were drawn."


@dataclass(frozen=True)
class SamplingTrial(DrawnTrial[SamplingRecord]):
    """Draw and verify."""

    title: ClassVar[str] = "Success of sampling"
    about: ClassVar[str] = (
        "Rates in % of what was attempted; in brackets, 95 % intervals by bootstrap over objects. Single: of all draws. "
        "Top-ranked: verified ones first, best first. First: the sampler's own first choice, before verification. Top of "
        f"k: of k draws, mean over all choices of k. Robust: with a force margin of at least {ROBUST_MARGIN:g}. Depths, "
        "margins, diversities and seconds are in report.csv."
    )
    folder: ClassVar[str] = ""
    record: ClassVar[type[SamplingRecord]] = SamplingRecord
    needs_verified: ClassVar[bool] = False
    metrics: ClassVar[Sequence[Metric]] = METRICS
    rate: ClassVar[str] = "single"

    def start_with(self, sampler: TrialSampler) -> Callable[[Samples, int], dict[str, Any]]:
        """Return what makes fields of a record of verified draws."""

        def fields(samples: Samples, _: int) -> dict[str, Any]:
            verdicts, verified = samples.verdicts, np.flatnonzero(samples.success)
            contacts = [verdicts.contacts[index] for index in verified]
            deepest = verdicts.deepest_penetration.tolist()
            return {
                "success": verdicts.success.tolist(),
                "force_margin": [round(float(margin), 4) for margin in verdicts.force_margin],
                "penetration_mm": [round(1e3 * depth, 4) if np.isfinite(depth) else None for depth in deepest],
                "own_rank": [] if samples.own_rank is None else samples.own_rank.tolist(),
                "joint_diversity": joint_diversity(samples.q[verified], sampler.hand.joint_scales),
                "contact_diversity": contact_diversity(sampler.hand, samples.scene, contacts),
                "swept": verify_disturbed(samples.scene, verdicts) if sampler.config.sweep else {},
                "rejected": samples.rejections(),
                "repairs": list(samples.scene.object_mesh.metadata.get("notes", ())),
            }

        return fields

    def sections(self, records: Sequence[SamplingRecord]) -> list[Section]:
        """Return what the tables of metrics leave open.

        The methods at equal time, success at other frictions and masses, which objects failed, and what was repaired when
        objects were read, where there is such.
        """
        compared, disturbed = equal_time(records), measure_disturbed(records)
        found = []
        if compared:
            table = metric_table(compared, EQUAL_TIME)
            found.append(Section("At equal time on the wall clock", ABOUT_EQUAL_TIME, table, numbers=compared))
        if disturbed:
            table = metric_table(disturbed, DISTURBED, ["setting"])
            found.append(Section("At other frictions and masses", ABOUT_DISTURBED, table, numbers=disturbed))
        failed = {(each.object, each.reason) for each in records if each.status == "failed"}
        repaired = {(each.object, note) for each in records for note in each.repairs}
        for title, said in (
            ("Objects that failed", failed),
            ("Objects that were repaired when they were read", repaired),
        ):
            if said:
                found.append(Section(title, "\n".join(f"- {name}: {what}" for name, what in sorted(said))))
        return found


def joint_diversity(q: Float[np.ndarray, "n coordinates"], scales: Float[np.ndarray, " joint"]) -> float | None:
    """Return the standard deviation (n - 1) of each joint angle over the configurations, mean over the joints [rad].

    scales: what counts as a radian of each, see `Hand.joint_scales`.
    """
    if len(q) < SEVERAL:
        return None
    return float((q[:, ROOT_COORDINATES:].astype(np.float64).std(axis=0, ddof=1) / scales).mean())


def contact_diversity(hand: Hand, scene: Scene, contacts: Sequence[HandContacts]) -> float | None:
    """Return the mean distance of the fingertips' contact places from their common mean, over half the object's length.

    A place is the mean of one fingertip's contact points in one configuration, so that a flat contact counts no more
    than a point.
    """
    places = [
        each.points[each.link == hand.link_names.index(tip)].mean(axis=0)
        for each in contacts
        for tip in hand.fingertip_links
        if (each.link == hand.link_names.index(tip)).any()
    ]
    if len(places) < SEVERAL:
        return None
    half_length = 0.5 * float(np.max(scene.object_mesh.extents))
    away = np.linalg.norm(np.array(places) - np.mean(places, axis=0), axis=1)
    return float(away.mean()) / half_length
