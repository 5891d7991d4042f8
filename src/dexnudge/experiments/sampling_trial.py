"""Sampling: the draws for an object in a scene, verified."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from dexnudge.experiments.comparisons import ABOUT_EQUAL_TIME, EQUAL_TIME, equal_time
from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_seed
from dexnudge.experiments.disturbances import verify_disturbed
from dexnudge.experiments.metrics import Metric
from dexnudge.experiments.sampling_records import (
    ABOUT_DISTURBED,
    DISTURBED,
    MEASURES,
    RATES,
    REJECTED,
    SECONDS,
    SamplingRecord,
    measure_disturbed,
)
from dexnudge.experiments.tables import metric_table
from dexnudge.experiments.trial import Section, TrialKind
from dexnudge.experiments.trial_sampler import TrialSampler
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import ROBUST_MARGIN

SEVERAL = 2  # fewer configurations, or contact places, have no diversity


@dataclass(frozen=True)
class SamplingTrial(TrialKind[SamplingRecord]):
    """Draw and verify."""

    title: ClassVar[str] = "Success of sampling"
    about: ClassVar[str] = (
        "Rates in % of what was attempted; in brackets, 95 % intervals by bootstrap over objects. Top-ranked: verified "
        "ones first, best first. First: the sampler's own first choice, before verification. Top of k: of k draws, mean "
        f"over all choices of k. Robust: with a force margin of at least {ROBUST_MARGIN:g}."
    )
    folder: ClassVar[str] = ""
    record: ClassVar[type[SamplingRecord]] = SamplingRecord
    needs_verified: ClassVar[bool] = False
    tables: ClassVar[Mapping[str, Sequence[Metric]]] = {
        "": RATES,
        "Depth, force, variety, cost": MEASURES,
        "Why draws were rejected": (REJECTED,),
        "Seconds per object, scene and method": (SECONDS,),
    }
    rate: ClassVar[str] = "single"

    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], SamplingRecord]:
        """Load the sampler; return what draws for a trial."""
        sampler = TrialSampler(config)

        def run(key: TrialKey) -> SamplingRecord:
            drawn = sampler.draw(key)
            samples, verdicts = drawn.samples, drawn.samples.verdicts
            deepest = verdicts.deepest_penetration
            verified = np.flatnonzero(verdicts.success)
            return SamplingRecord(
                **key._asdict(),
                num=len(samples.q),
                verified=len(verified),
                seed=trial_seed(config.seed, key),
                success=verdicts.success.tolist(),
                force_margin=[round(float(margin), 4) for margin in verdicts.force_margin],
                penetration_mm=[round(1e3 * depth, 4) if np.isfinite(depth) else None for depth in deepest.tolist()],
                own_rank=[] if samples.own_rank is None else samples.own_rank.tolist(),
                joint_diversity=joint_diversity(samples.q[verified]),
                contact_diversity=contact_diversity(
                    sampler.hand, drawn.scene, [verdicts.contacts[index] for index in verified]
                ),
                swept=verify_disturbed(drawn.scene, verdicts) if config.sweep else {},
                rejected=samples.rejections(),
                seconds={stage: round(value, 4) for stage, value in drawn.seconds.items()},
            )

        return run

    def succeeded(self, record: SamplingRecord) -> bool:
        """Return whether the top-ranked draw succeeds."""
        return any(record.success[:1])

    def sections(self, records: Sequence[SamplingRecord]) -> list[Section]:
        """Return the methods at equal time, and success at other frictions and masses, where there are such figures."""
        compared, disturbed = equal_time(records), measure_disturbed(records)
        found = []
        if compared:
            table = metric_table(compared, EQUAL_TIME)
            found.append(Section("At equal time on the wall clock", ABOUT_EQUAL_TIME, table, numbers=compared))
        if disturbed:
            table = metric_table(disturbed, DISTURBED, ["setting"])
            found.append(Section("At other frictions and masses", ABOUT_DISTURBED, table, numbers=disturbed))
        return found


def joint_diversity(q: Float[np.ndarray, "n coordinates"]) -> float | None:
    """Return the standard deviation (n - 1) of each joint angle over the configurations, mean over the joints [rad]."""
    if len(q) < SEVERAL:
        return None
    return float(q[:, ROOT_COORDINATES:].astype(np.float64).std(axis=0, ddof=1).mean())


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
