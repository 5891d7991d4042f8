"""`dexnudge sample`: verified, ranked hand configurations for one object in one scene."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from dexnudge.cli.arguments import (
    NOTHING_SUCCEEDED,
    Count,
    DeviceOptions,
    Flag,
    Losses,
    Meshes,
    OptionalCount,
    OptionalFolder,
    Plugins,
    Text,
    Uncertain,
    counted,
    metavar,
    out_folder,
    refuse_beside,
    refuse_unused_weights,
    say,
    with_flags,
)
from dexnudge.cli.arm_options import ArmOptions
from dexnudge.cli.scene_options import RUNS, SceneOptions, say_findings, stop_at_errors
from dexnudge.errors import InputError

if TYPE_CHECKING:
    from dexnudge.results.samples import Samples


@dataclass(frozen=True, kw_only=True)
class Sample(DeviceOptions, SceneOptions):
    """Draw hand configurations that can make an object move, verify and rank them.

    The scene is drawn from a family (--scene), your own (--environment, --object-pose, --motion), or a folder that `scene`
    wrote. What is understood of it is printed first; errors end the command. Exit code 3: everything is written, but no
    draw is verified. With --arm, a draw is verified only where the arm brings the hand there and along the motion;
    --term reach draws more of those, and takes longer.
    """

    out: OptionalFolder = None
    """Folder to write; unless given runs/OBJECT-SCENE, numbered where that is taken."""
    overwrite: Flag = False
    """Replace an existing result folder; other files in it stay."""
    num: Count = 32
    """Number of draws; all of them are written, verified ones first."""
    verified: Annotated[int | None, metavar("K")] = None
    """Go on drawing until K are verified."""
    max_draws: OptionalCount = None
    """With --verified: give up after this many draws; 32 K unless given."""
    weights: OptionalFolder = None
    """Folder of the model; unless given that beside the hand's description (weights/), else the shipped one."""
    method: Text = "steered_noise"
    """Sampling method; an unknown name lists them."""
    uncertain: Uncertain = ()
    """Rank by the share of sampled worlds in which a draw holds, and aim at the hardest of them. Factors on the scene's own
    numbers: friction (of the hand), friction_environment, mass, max_normal_force, such as friction=0.5..1; how far off the
    object may lie: pose_mm, pose_deg, height_mm; worlds=16 and seed=0 unless given."""
    robot: ArmOptions = field(default_factory=ArmOptions)
    losses: Losses = field(default_factory=Losses)
    plugins: Plugins = field(default_factory=Plugins)
    meshes: Meshes = "visual"
    """What pictures and pages show of the hand: visual meshes where its description has them, or what is judged."""
    projection_report: Flag = False
    """Also verify the draws as they were before the projection, for the summary; takes about twice as long."""

    def run(self) -> int:
        """Sample, verify, write, print."""
        self.check_options()
        from dexnudge.jobs.processes import loading_libraries, release_memory

        with loading_libraries():
            from dexnudge.results.folder import result_folder, write_results

        out = out_folder(self.out, RUNS / f"{self.label}-{self.place}", overwrite=self.overwrite)
        with result_folder(out, overwrite=self.overwrite) as folder:
            samples, told = self._sample_into(folder)
            release_memory()  # of what drew, before page and picture take theirs
            summary = write_results(folder, samples, **told)
        _print(summary)
        if self.verified and summary["verified"] < self.verified:
            say(
                f"{summary['verified']} of the {self.verified} verified draws asked for were reached in {summary['drawn']} "
                "draws; raise --max-draws for more"
            )
        say(f"written: {out}")
        return 0 if summary["verified"] else NOTHING_SUCCEEDED

    def _sample_into(self, folder: Path) -> tuple[Samples, dict[str, Any]]:
        """Write scene and hand into `folder`; return the draws and the further arguments of `write_results`."""
        from dexnudge.energies.terms import find_term
        from dexnudge.hands.registry import load_hand
        from dexnudge.planning.reach import Reach
        from dexnudge.planning.reach_term import WEIGHT as REACH_WEIGHT
        from dexnudge.planning.reach_term import ReachTerm
        from dexnudge.results.folder import write_inputs
        from dexnudge.results.worlds import what_to_do
        from dexnudge.sampling.methods import find_method
        from dexnudge.sampling.sampler import Sampler, check_counts
        from dexnudge.scenes.uncertainty import Uncertainty
        from dexnudge.verification.criteria import named_criteria

        check_counts(self.num, self.verified, self.max_draws)
        uncertainty = Uncertainty.parse(self.uncertain) if self.uncertain else None
        weights = self.plugins.weights()
        if ReachTerm.name in weights and self.robot.arm is None:
            raise InputError("term 'reach' is given without `arm`; name the arm, or leave it out")
        terms = [find_term(name, weight=weight) for name, weight in weights.items() if name != ReachTerm.name]
        criteria = named_criteria(self.plugins.criterion)
        method = find_method(self.method).with_weights(self.losses.given())
        refuse_unused_weights(self, [self.method])
        if method.projection is None:
            refuse_beside(f"`method` {self.method}, which projects nothing", self, "projection_report")
        start = time.perf_counter()
        name, scene = self.build()
        scene = replace(scene, uncertainty=uncertainty or scene.uncertainty)
        hand = load_hand(self.hand, base=self.base)
        if self.meshes == "collision":
            hand = replace(hand, shown_by=())
        findings = self.what_matters(scene, hand)
        stop_at_errors(findings)
        say_findings(findings, Sample, only_what_matters=True)
        say(*(f"note: {note}" for note in hand.notes))
        robot = self.robot.robot(hand, scene)
        if robot is not None:
            say(f"reach: of {robot.arm!r}")
            criteria.append(Reach(robot.arm, mount=robot.T_flange_mount))
            if ReachTerm.name in weights:
                given = weights[ReachTerm.name]
                weight = REACH_WEIGHT if given is None else given
                terms.append(ReachTerm(robot.arm, mount=robot.T_flange_mount, weight=weight))
        sampler = Sampler(hand, terms=terms, weights=self.weights, device=self.device)
        sampler.load(method)
        written_scene, written_hand = write_inputs(folder, scene, hand)
        seconds = {"load": time.perf_counter() - start}
        with counted("drawing", total=self.verified or self.num) as show:

            def drawing(drawn: int, verified: int) -> None:
                show(verified if self.verified else drawn, description=f"drawn {drawn}, verified {verified}")

            samples = sampler.sample(
                written_scene,
                hand=written_hand,
                num=self.num,
                seed=self.seed,
                method=method,
                criteria=criteria,
                verified=self.verified,
                max_draws=self.max_draws,
                on_progress=drawing,
            )
        details = {
            "object": name,
            "scene": scene.name,
            "hand": hand.name,
            "arm": None if robot is None else robot.arm.name,
            "method": self.method,
            "energy": method.weights(),
            "terms": {term.name: term.weight for term in terms},
            "seed": self.seed,
            "weights": sampler.weights_name if method.start == "prior" else "none",
            "device": sampler.device,
        }
        if scene.uncertainty is not None and samples.num_verified:
            details["uncertain"] = what_to_do(written_scene, samples[0].share_of_worlds)
        if self.projection_report:
            from dexnudge.experiments.comparisons import projection_effect

            details["projection"] = projection_effect(
                sampler, written_hand, written_scene, num=self.num, seed=self.seed, method=method
            )
        return samples, {"title": f"{name}, {scene.name}", "seconds": seconds, "details": details}


def _print(summary: dict[str, Any]) -> None:
    from dexnudge.cli.arguments import stdout, table
    from dexnudge.results.folder import nothing_verified

    counts = table("draws", "number", "share")
    drawn = summary["drawn"]
    rows = [("drawn", drawn), ("verified", summary["verified"]), ("  robust", summary["robust"])]
    rows += [(f"rejected, first reason: {reason}", number) for reason, number in summary["rejected"].items()]
    for label, number in rows:
        counts.add_row(label, str(number), f"{number / drawn:.0%}")
    stages = ", ".join(f"{stage} {value:.1f}" for stage, value in summary["seconds"].items())
    best = summary["best_force_margin"]
    say(f"{summary['object']}, {summary['scene']}, {summary['hand']}; weights: {summary['weights']}")
    stdout().print(counts)
    say(with_flags(nothing_verified(summary), Sample) if best is None else f"force margin of the best draw: {best:.2f}")
    if (probability := summary["best_foresight"].get("probability")) is not None:
        from dexnudge.finding import probability_text

        say(f"probability that the best holds in physics: {probability_text(probability)}")
    say(*([with_flags(summary["uncertain"], Sample)] if "uncertain" in summary else []))
    say(f"seconds: {stages}; total {summary['seconds_total']:.1f}; memory {summary['peak_memory_mb']:.0f} MB")
