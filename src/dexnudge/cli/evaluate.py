"""`dexnudge evaluate`: success over many objects and scenes, with intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from dexnudge.cli.arguments import (
    Count,
    DeviceOptions,
    EngineOptions,
    Flag,
    Losses,
    OptionalCount,
    OptionalFolder,
    Physics,
    Plugins,
    Scenes,
    SetOptions,
    Turning,
    Uncertain,
    check_at_least,
    given,
    metavar,
    refuse_unused_weights,
    refuse_without,
    say,
    settings,
)
from dexnudge.cli.arm_options import EvaluatedArm
from dexnudge.errors import InputError
from dexnudge.experiments.config import ScanErrors

if TYPE_CHECKING:
    from dexnudge.experiments.config import ExperimentConfig
    from dexnudge.experiments.trial import TrialKind

ATTEMPTS = 3  # with --then-grasp, unless given


@dataclass(frozen=True, kw_only=True)
class Evaluate(DeviceOptions, EngineOptions, SetOptions):
    """Success of sampling over a set of objects and scenes, with 95 % intervals over objects.

    Stopped runs go on where they were: give the same options and the same --out again.
    """

    max_objects: OptionalCount = None
    """Take this many of the set, evenly spaced; all unless given."""
    scenes: Scenes = ("table", "layers", "shelf")
    """Scene families."""
    method: Annotated[tuple[str, ...], metavar("NAME...")] = ("steered_noise",)
    """Sampling methods to compare; an unknown name lists them."""
    num: Count = 32
    """Draws for each object, scene and method."""
    base: Flag = True
    """Leave the forearm out of the hand's geometry."""
    physics: Physics = field(default_factory=Physics)
    uncertain: Uncertain = ()
    """Rank by the share of sampled worlds in which a draw holds, as `sample` does, such as friction=0.5..1 mass=0.5..2."""
    turning: Turning = field(default_factory=Turning)
    losses: Losses = field(default_factory=Losses)
    plugins: Plugins = field(default_factory=Plugins)
    weights: OptionalFolder = None
    """Folder of the model; unless given that beside the hand's description (weights/), else the shipped one."""
    data: OptionalFolder = None
    """Dataset folder, for the method nearest_pose."""
    execute: Flag = False
    """Also play the best verified draw of each in physics, for the executed rate."""
    execute_num: Count = 1
    """With --execute: play this many of each, best first."""
    execute_errors: Flag = False
    """With --execute: play the best one with other frictions and masses, too."""
    open_loop: Flag = False
    """With --execute: play what was planned, whatever comes of it; else the hand answers what it feels and sees."""
    then_grasp: Flag = False
    """Also slide, grasp and lift each object with its verified draws, for the lifted rate."""
    attempts: OptionalCount = None
    """With --then-grasp: most attempts for each object; 3 unless given."""
    robot: EvaluatedArm = field(default_factory=EvaluatedArm)
    scan: Flag = False
    """Sample in scans of the scenes, and judge in the scenes themselves what is verified there; nothing else is run."""
    scans: ScanErrors = field(default_factory=ScanErrors)

    def run(self) -> int:
        """Run the missing trials of each kind, write and print their reports."""
        check_at_least(0, seed=self.seed)
        from dexnudge.sampling.sampler import check_counts

        check_counts(self.num, None, None)
        check_at_least(1, workers=self.workers, execute_num=self.execute_num)
        self._check_options()
        check_at_least(1, attempts=self.attempts)
        say(*self._reports(), f"written: {self.out}")
        return 0

    def _check_options(self) -> None:
        """Refuse options that need another one, or that exclude each other; InputError."""
        if not self.execute:
            refuse_without("execute", self, "execute_num", "execute_errors", "open_loop")
        if not self.then_grasp:
            refuse_without("then_grasp", self, "attempts")
        if not self.scan:
            refuse_without("scan", self.scans)
        with_scan = ("then_grasp", "execute_num", "execute_errors", "open_loop")
        with_arm = ("scan", "attempts", "execute_num", "execute_errors", "open_loop")
        if not self.then_grasp:  # which draws grasps
            refuse_unused_weights(self, self.method)
        for one, there, others in (("scan", self.scan, with_scan), ("arm", self.robot.arm, with_arm)):
            for other in given(self, *others) if there else ():
                raise InputError(
                    f"`{one}` and `{other}` are both given; expected one of them; run them one after the other"
                )
        if self.engine == "ray" and self.device != "cpu":
            raise InputError(
                f"`device` is '{self.device}' with `engine` ray, whose workers are given cores alone; expected cpu"
            )

    def _config(self) -> "ExperimentConfig":
        from dexnudge.experiments.config import ExperimentConfig

        return settings(
            ExperimentConfig,
            self,
            methods=self.method,
            physics=self.physics.given() | self.turning.given(),
            losses=self.losses.given() or None,
            terms=self.plugins.weights() or None,
            criteria=self.plugins.criterion,
        )

    def _kinds(self) -> "list[TrialKind[Any]]":
        from dexnudge.experiments.sampling_trial import SamplingTrial

        if self.scan:
            from dexnudge.experiments.scan_trial import ScanTrial

            return [ScanTrial(self.scans, execute=self.execute)]
        if (arm := self.robot.trial(execute=self.execute, then_grasp=self.then_grasp)) is not None:
            return [arm]
        kinds: list[TrialKind[Any]] = [SamplingTrial()]
        if self.execute:
            from dexnudge.experiments.execution_trial import ExecutionTrial

            kinds.append(ExecutionTrial(num=self.execute_num, errors=self.execute_errors, feedback=not self.open_loop))
        if self.then_grasp:
            from dexnudge.experiments.lifting_trial import LiftingTrial

            kinds.append(LiftingTrial(attempts=ATTEMPTS if self.attempts is None else self.attempts))
        return kinds

    def _reports(self) -> list[str]:
        """Run the missing trials and write their reports, kind by kind."""
        from dexnudge.experiments.report import write_report
        from dexnudge.experiments.run import TrialRunner
        from dexnudge.jobs.progress import progress

        out, kinds = Path(self.out), self._kinds()
        with progress() as bars:
            tasks = {kind: bars.add_task(kind.title, total=None) for kind in kinds}

            def show(kind: "TrialKind[Any]", records: Sequence[Any], total: int) -> None:
                text = f"{kind.title}: {sum(each.succeeded for each in records)} top-ranked succeed"
                bars.update(tasks[kind], completed=len(records), total=total, description=text)

            runner = TrialRunner(kinds, self._config(), out)
            run = runner.run(workers=self.workers, engine=self.engine, ray_address=self.ray_address, on_record=show)
            return [write_report(kind, out) for kind, _ in run]
