"""`dexnudge evaluate`: success over many objects and scenes, with intervals."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    from dexnudge.experiments.trial import TrialKind

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
        """Run the missing trials of each kind, write and print their reports."""
        check_at_least(0, seed=self.seed)
        check_at_least(1, num=self.num, workers=self.workers, execute_num=self.execute_num)
        self._check_tries()
        from dexnudge.cli.arguments import stdout

        console = stdout()
        for report in self._reports():
            console.print(report, markup=False, soft_wrap=True)
        console.print(f"written: {self.out}", soft_wrap=True)
        return 0

    def _check_tries(self) -> None:
        if self.tries is None:
            return
        if not self.then_grasp:
            raise InputError(f"--tries is {self.tries} without --then-grasp; expected both; add --then-grasp")
        check_at_least(1, tries=self.tries)

    def _config(self) -> "ExperimentConfig":
        from dexnudge.experiments.config import ExperimentConfig

        return ExperimentConfig(
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

    def _kinds(self) -> "list[TrialKind[Any]]":
        from dexnudge.experiments.sampling_trial import SamplingTrial

        kinds: list[TrialKind[Any]] = [SamplingTrial()]
        if self.execute:
            from dexnudge.experiments.execution_trial import ExecutionTrial

            kinds.append(ExecutionTrial(num=self.execute_num, errors=self.execute_errors))
        if self.then_grasp:
            from dexnudge.experiments.lifting_trial import LiftingTrial

            kinds.append(LiftingTrial(tries=TRIES if self.tries is None else self.tries))
        return kinds

    def _reports(self) -> list[str]:
        """Run the missing trials and write their reports, kind by kind."""
        from dexnudge.experiments.report import write_report
        from dexnudge.experiments.run import TrialRunner
        from dexnudge.jobs.progress import progress

        out, kinds = Path(self.out), self._kinds()
        with progress() as bars:
            tasks = {kind: bars.add_task(kind.title, total=None) for kind in kinds}
            succeeded = dict.fromkeys(kinds, 0)

            def show(kind: "TrialKind[Any]", record: Any, finished: int, total: int) -> None:
                succeeded[kind] += kind.succeeded(record)
                text = f"{kind.title}: {succeeded[kind]} top-ranked succeed"
                bars.update(tasks[kind], completed=finished, total=total, description=text)

            runner = TrialRunner(kinds, self._config(), out)
            return [write_report(kind, out) for kind, _ in runner.run(workers=self.workers, on_record=show)]
