"""`dexnudge evaluate`: success over many objects and scenes, with intervals."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dexnudge.cli.arguments import (
    Count,
    Folder,
    Losses,
    OptionalCount,
    OptionalFolder,
    OptionalNumber,
    Physics,
    Text,
    Units,
    check_at_least,
    metavar,
)
from dexnudge.errors import InputError

if TYPE_CHECKING:
    from dexnudge.experiments.config import ExperimentConfig
    from dexnudge.experiments.experiment_rows import ExecutionRow
    from dexnudge.experiments.lift_experiment_rows import LiftRow
    from dexnudge.experiments.rows import Row

TRIES = 3  # with --then-grasp, unless given


@dataclass(frozen=True)
class Evaluate:
    """Success of sampling over a set of objects and scenes, with 95 % intervals over objects.

    Stopped runs go on where they were: give the same options and the same --out again.
    """

    objects: Annotated[str, metavar("SET")]
    """Folder of meshes, text file of paths, builtin:test, or a DexGraspNet meshdata folder (scale 0.08)."""
    out: Folder
    """Folder of the experiment."""
    max_objects: OptionalCount = None
    """Take this many of the set, evenly spaced; all unless given."""
    scenes: Annotated[tuple[str, ...], metavar("FAMILY...")] = ("table", "layers", "shelf")
    """Scene families."""
    method: Annotated[tuple[str, ...], metavar("NAME...")] = ("steered_noise",)
    """Sampling methods to compare; an unknown name lists them."""
    num: Count = 32
    """Draws for each object, scene and method."""
    seed: Count = 0
    """Of the experiment; objects and scenes get seeds derived from it."""
    workers: Count = 2
    """Processes; one core each."""
    units: Units = "m"
    """Unit of the numbers in mesh files."""
    length: OptionalNumber = None
    """Scale every object so that its longest side has this length [m]."""
    hand: Text = "shadow_lite"
    """Built-in hand or URDF file."""
    base: bool = True
    """Whether the forearm is part of the hand's geometry."""
    physics: Physics = field(default_factory=Physics)
    losses: Losses = field(default_factory=Losses)
    weights: OptionalFolder = None
    """Folder of the model; the shipped one unless given."""
    data: OptionalFolder = None
    """Dataset folder, for the method nearest_pose."""
    device: Text = "cpu"
    """torch device to sample on."""
    execute: bool = False
    """Also play the best verified draw of each in physics, for the executed rate."""
    execute_num: Count = 1
    """With --execute: play this many of each, best first."""
    execute_errors: bool = False
    """With --execute: play the best one with other frictions and masses, too."""
    then_grasp: bool = False
    """Also slide, grasp and lift each object with its verified draws, for the lifted rate."""
    tries: OptionalCount = None
    """With --then-grasp: most tries for each object; 3 unless given."""

    def run(self) -> int:
        """Compute the missing rows, write and print the report."""
        check_at_least(0, seed=self.seed)
        check_at_least(1, num=self.num, workers=self.workers, execute_num=self.execute_num)
        self._check_tries()
        from dexnudge.cli.arguments import stdout
        from dexnudge.experiments.config import ExperimentConfig
        from dexnudge.jobs.folders import owned_folder

        config = ExperimentConfig(
            objects=self.objects,
            max_objects=self.max_objects,
            scenes=self.scenes,
            methods=self.method,
            num=self.num,
            seed=self.seed,
            units=self.units,
            length=self.length,
            hand=self.hand,
            base=self.base,
            physics=self.physics.given(),
            weights=self.weights,
            data=self.data,
            device=self.device,
            losses=self.losses.given() or None,
        )
        with owned_folder(self.out):
            self._run(config)
        stdout().print(f"written: {self.out}", soft_wrap=True)
        return 0

    def _run(self, config: "ExperimentConfig") -> None:
        from dexnudge.cli.arguments import stdout
        from dexnudge.experiments.experiments import run_experiment
        from dexnudge.experiments.report import write_report
        from dexnudge.jobs.progress import progress

        drawn = verified = 0
        with progress() as bars:
            bar = bars.add_task("evaluating", total=None)

            def show(row: "Row", finished: int, total: int) -> None:
                nonlocal drawn, verified
                drawn += row.num
                verified += sum(row.success)
                description = f"drawn {drawn}, verified {verified} ({verified / drawn:.0%})"
                bars.update(bar, completed=finished, total=total, description=description)

            run_experiment(config, Path(self.out), workers=self.workers, on_row=show)
        report = write_report(Path(self.out))
        console = stdout()
        console.print(report, markup=False, soft_wrap=True)
        if self.execute:
            console.print(self._executed(config), markup=False, soft_wrap=True)
        if self.then_grasp:
            console.print(self._lifted(config), markup=False, soft_wrap=True)

    def _check_tries(self) -> None:
        if self.tries is None:
            return
        if not self.then_grasp:
            raise InputError(f"--tries is {self.tries} without --then-grasp; expected both; add --then-grasp")
        check_at_least(1, tries=self.tries)

    def _executed(self, config: "ExperimentConfig") -> str:
        """Compute the missing executions; return their report."""
        from dexnudge.experiments.execution_experiment import run_executions
        from dexnudge.experiments.experiment_report import write_execution_report
        from dexnudge.jobs.progress import progress

        succeeded = 0
        with progress() as bars:
            bar = bars.add_task("executing", total=None)

            def show(row: "ExecutionRow", finished: int, total: int) -> None:
                nonlocal succeeded
                succeeded += row.top_succeeded
                bars.update(
                    bar, completed=finished, total=total, description=f"executing, {succeeded} top-ranked succeed"
                )

            run_executions(
                config,
                Path(self.out),
                num=self.execute_num,
                errors=self.execute_errors,
                workers=self.workers,
                on_row=show,
            )
        return write_execution_report(Path(self.out))

    def _lifted(self, config: "ExperimentConfig") -> str:
        """Compute the missing lifts; return their report."""
        from dexnudge.experiments.lift_experiment import run_lifts
        from dexnudge.experiments.lift_experiment_report import write_lift_report
        from dexnudge.jobs.progress import progress

        lifted = 0
        with progress() as bars:
            bar = bars.add_task("lifting", total=None)

            def show(row: "LiftRow", finished: int, total: int) -> None:
                nonlocal lifted
                lifted += row.lifted
                bars.update(bar, completed=finished, total=total, description=f"lifting, {lifted} lifted")

            tries = TRIES if self.tries is None else self.tries
            run_lifts(config, Path(self.out), tries=tries, workers=self.workers, on_row=show)
        return write_lift_report(Path(self.out))
