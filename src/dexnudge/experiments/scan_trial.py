"""Scans: configurations found in a scan of a known world, verified and executed in that world.

What is given of the true scene has the errors of `ScanErrors`. It is understood, sampled in and verified as a user's own
surroundings are; the judge of every configuration verified there is the true scene.
"""

import re
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from dexnudge.errors import SceneError
from dexnudge.execution.executor import Executor
from dexnudge.experiments.config import ExperimentConfig, ScanErrors, TrialKey, trial_seed
from dexnudge.experiments.metrics import FAILED, OBJECTS, Metric, mean, share, share_of
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.scanned_world import scanned_world
from dexnudge.experiments.tables import Table
from dexnudge.experiments.trial import Section, TrialKind, TrialSampler
from dexnudge.hands.hand import Hand
from dexnudge.planning.approach import Approach
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.success import judge_push
from dexnudge.verification.verdicts import Verdicts, verify

NOT_EXECUTED = ""
NUMBER = re.compile(r"-?\d+(\.\d+)?")


@dataclass(frozen=True, kw_only=True)
class ScanRecord(TrialRecord):
    """What became of the configurations that were found in a scan.

    Attributes:
        refused: the message with which the scan was refused; "" where it was understood.
        notes: what was done to understand it, a sentence each. surface_noise, clearance: of the understood scene [m].
        pose_error_mm, pose_error_deg: of the object's pose as it was understood, after it settled, at its centre.
        motion_error_deg: angle between the understood and the true motion.
        rejected: draws that are not verified in the scan, by reason.
        true: whether each configuration that is verified in the scan is so in the true scene, best first.
        reasons: why each of them is false; "" where it is true.
        penetration_mm: deepest penetration of each in the true scene. force_margin: of each there.
        outcome: value of the `Outcome` of the best one, planned in the scan and played in the true scene; "" where nothing
            was played. length_asked, length_reached [m]: of that push. approach: name of the planner, "" where there was no
            free way to contact.
    """

    kind: ClassVar[str] = "scan"

    refused: str = ""
    notes: list[str] = field(default_factory=list)
    surface_noise: float = 0.0
    clearance: float = 0.0
    pose_error_mm: float | None = None
    pose_error_deg: float | None = None
    motion_error_deg: float | None = None
    rejected: dict[str, int] = field(default_factory=dict)
    true: list[bool] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    penetration_mm: list[float | None] = field(default_factory=list)
    force_margin: list[float] = field(default_factory=list)
    outcome: str = NOT_EXECUTED
    length_asked: float | None = None
    length_reached: float | None = None
    approach: str = ""

    @property
    def succeeded(self) -> bool:
        """Whether the best configuration that was verified in the scan is verified in the true scene, too."""
        return bool(self.true) and self.true[0]

    @property
    def executed(self) -> bool:
        """Whether it also moved the true object as it should."""
        return self.outcome == Outcome.SUCCESS.value


Records = Sequence[ScanRecord]


def _why_not_top(records: Records) -> dict[str, int]:
    """Trials by what keeps their best configuration from being true."""
    found = Counter(_why_not(each) for each in records)
    return {reason: count for reason, count in found.most_common() if reason}


def _why_not(record: ScanRecord) -> str:
    if record.status == "failed":
        return "object failed"
    if record.refused:
        return "scan refused"
    if not record.true:
        return "no draw verified in the scan"
    return record.reasons[0].replace("_", " ")


def _outcomes(records: Records) -> dict[str, int]:
    """Played pushes that fail, by outcome."""
    found = Counter(each.outcome.replace("_", " ") for each in records if each.outcome and not each.executed)
    return dict(found.most_common())


@dataclass(frozen=True)
class ScanTrial(TrialKind[ScanRecord]):
    """Sample in a scan of a trial's scene; verify in the scene itself what is verified in the scan.

    errors: of the scan. execute: whether the best configuration is also planned in the scan and played in the true scene.
    """

    title: ClassVar[str] = "Sampled in scans, judged in the true scene"
    about: ClassVar[str] = (
        "Refused: scans that were not understood. Verified: draws that are verified in the scan; and true: in the true "
        "scene, too; of these: the share of verified ones that are true. Top-ranked true, any true: % of all attempted "
        "objects of which the best, or any one, is. Executed: % of all whose best one, planned in the scan, moves the "
        "object in the true scene. In brackets, 95 % intervals by bootstrap over objects."
    )
    folder: ClassVar[str] = "scan"
    record: ClassVar[type[ScanRecord]] = ScanRecord
    needs_verified: ClassVar[bool] = False
    metrics: ClassVar[Sequence[Metric]] = (
        OBJECTS,
        FAILED,
        Metric("refused", lambda records: sum(bool(each.refused) for each in records), "refused", 0),
        Metric("verified", share(lambda each: each.verified / each.num), "verified"),
        Metric("single_true", share(lambda each: sum(each.true) / each.num), "and true"),
        Metric("true", share_of(lambda each: each.true), "of these"),
        Metric("top_true", share(lambda each: each.succeeded), "top-ranked true"),
        Metric("any_true", share(lambda each: any(each.true)), "any true"),
        Metric("executed", share(lambda each: each.executed), "executed"),
        Metric("pose_error_mm", mean(lambda each: each.pose_error_mm), "pose off, mm", 1),
        Metric("pose_error_deg", mean(lambda each: each.pose_error_deg), "pose off, deg", 1),
        Metric("why_not", _why_not_top, "Why top-ranked are not true", "counts"),
        Metric("outcomes", _outcomes, "Why executions failed", "counts"),
    )
    rate: ClassVar[str] = "top_true"

    errors: ScanErrors = field(default_factory=ScanErrors)
    execute: bool = True

    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], ScanRecord]:
        """Load the sampler; return what scans a trial's scene, draws, verifies and executes."""
        sampler = TrialSampler(config)

        def run(key: TrialKey) -> ScanRecord:
            clock, seed = time.perf_counter(), trial_seed(config.seed, key)
            world = scanned_world(sampler.scene(key), self.errors, seed=seed)
            common = {**key._asdict(), "seed": seed, "num": config.num}
            try:
                scan = world.understood()
            except SceneError as error:
                return ScanRecord(**common, refused=f"{type(error).__name__}: {error}")
            seconds = {"scan": time.perf_counter() - clock}
            samples = sampler.draw_in(scan, key)
            best, clock = samples.verified, time.perf_counter()
            verdicts = verify(world.truth, sampler.hand, best.q, sampler.criteria)
            seconds |= {**samples.seconds, "true": time.perf_counter() - clock}
            clock = time.perf_counter()
            played = played_in(world.truth, scan, sampler.hand, best.q[0]) if self.execute and len(best) else {}
            seconds["play"] = time.perf_counter() - clock
            return ScanRecord(
                **common,
                verified=len(best),
                notes=list(scan.notes),
                surface_noise=scan.surface_noise,
                clearance=scan.clearance,
                **understanding_errors(world.truth, scan),
                rejected=samples.rejections(),
                **_judged(verdicts),
                **played,
                seconds={stage: round(value, 4) for stage, value in seconds.items()},
            )

        return run

    def sections(self, records: Records) -> list[Section]:
        """Return what the errors of the scan were, and the refusals, numbers left out."""
        errors = Table(["error of the scan", "size"], list(asdict(self.errors).items()), labels=1)
        found = Counter((each.scene, NUMBER.sub("#", each.refused)) for each in records if each.refused)
        rows = [[scene, text.replace("|", "/"), count] for (scene, text), count in found.most_common()]
        refusals = [Section("Refusals", "", Table(["scene", "message", "objects"], rows))] if rows else []
        return [Section("Errors of the scan", "", errors), *refusals]


def _judged(verdicts: Verdicts) -> dict[str, Any]:
    """Fields of a record from the verdicts in the true scene, best ranked first."""
    deepest = verdicts.deepest_penetration
    return {
        "true": verdicts.success.tolist(),
        "reasons": list(verdicts.reasons),
        "penetration_mm": [round(1e3 * float(depth), 4) if np.isfinite(depth) else None for depth in deepest],
        "force_margin": [round(float(margin), 4) for margin in verdicts.force_margin],
    }


def understanding_errors(truth: Scene, scan: Scene) -> dict[str, Any]:
    """Return by how much the pose and the motion of an understood scene are off, by their names in `ScanRecord`."""
    off = scan.T_world_object @ np.linalg.inv(truth.T_world_object)
    centre = truth.object_in_world().center_mass
    moved = off[:3, :3] @ centre + off[:3, 3] - centre
    turned = np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1.0, 1.0))
    between = np.arccos(np.clip(scan.motion @ truth.motion, -1.0, 1.0))
    return {
        "pose_error_mm": round(1e3 * float(np.linalg.norm(moved)), 3),
        "pose_error_deg": round(float(np.degrees(turned)), 3),
        "motion_error_deg": round(float(np.degrees(between)), 3),
    }


def played_in(truth: Scene, scan: Scene, hand: Hand, q: Float[np.ndarray, " coordinates"]) -> dict[str, Any]:
    """Plan the push of q in the scan, play it in the true scene, and return the fields of a record.

    Way to contact, forces and length come from the scan, as a robot that knows nothing else would take them; the push is
    judged along the true motion.
    """
    execution = Executor(scan, scene_model(hand, truth))(q.astype(np.float64))
    asked, approach = execution.verdict.length_asked, execution.approach
    verdict = judge_push(
        execution.trace,
        motion=truth.object_motion,
        length=asked,
        max_normal_force=truth.max_normal_force,
        diverged=execution.divergence is not None,
    )
    return {
        "outcome": verdict.outcome.value,
        "length_asked": round(asked, 5),
        "length_reached": round(verdict.length_reached, 5),
        "approach": approach.planner if isinstance(approach, Approach) else "",
    }
