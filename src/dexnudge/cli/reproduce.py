"""`dexnudge reproduce`: Tables I and II of the paper and the rows that they lack, as one report."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dexnudge.cli.arguments import (
    DeviceOptions,
    Flag,
    OptionalCount,
    OptionalFolder,
    Scenes,
    Set,
    SetOptions,
    check_at_least,
    counted,
    metavar,
    named_folders,
    say,
    settings,
)

if TYPE_CHECKING:
    from dexnudge.experiments.records import TrialRecord
    from dexnudge.experiments.reproduction import ReproductionConfig


@dataclass(frozen=True, kw_only=True)
class Reproduce(DeviceOptions, SetOptions):
    """Tables I and II of the paper, every guidance rule and baseline, with and without the forearm, as one report.

    The draws are also verified at other frictions and masses, all methods are compared at equal time, and the worst
    cases are shown with a picture and a reason. All of builtin:test takes about an hour on two cores, --quick about four
    minutes. Stopped runs go on where they were: give the same options and the same --out again.
    """

    objects: Set = "builtin:test"
    """Folder of meshes, text file of paths, builtin:test, or a DexGraspNet meshdata folder (scale 0.08)."""
    max_objects: OptionalCount = None
    """Take this many of the set, evenly spaced; all unless given, 16 with --quick."""
    scenes: Scenes = ("table", "layers", "shelf")
    """Scene families of the tables; the parts hard and generalisation have their own."""
    parts: Annotated[tuple[str, ...] | None, metavar("PART...")] = None
    """Only these parts: with_base, without_base, grasps_only, predictions, hard (slot, deep, corner, clutter),
    generalisation (drawer, ramp, stack). All unless given; the first four with --quick."""
    methods: Annotated[tuple[str, ...] | None, metavar("NAME...")] = None
    """Only these of each part's methods; all unless given, an unknown name lists them."""
    num: OptionalCount = None
    """Draws for each object, scene and method; 32 unless given, 16 with --quick."""
    weights: OptionalFolder = None
    """Folder of the model; unless given that beside the hand's description (weights/), else the shipped one."""
    grasp_weights: OptionalFolder = None
    """Folder of a model trained on grasps only (train --grasp-fraction 1), for one more row of Table I."""
    prediction_weights: Annotated[tuple[str, ...], metavar("NAME=DIR...")] = ()
    """Models to compare with, such as one for each prediction type: epsilon=DIR sample=DIR v_prediction=DIR."""
    data: OptionalFolder = None
    """Dataset folder that the nearest training pose is taken from; without it that row is left out."""
    quick: Flag = False
    """Fewer objects, draws and methods: the rows of the paper's tables and the main baselines."""

    def run(self) -> int:
        """Run the missing trials, write and print the report."""
        check_at_least(0, seed=self.seed)
        check_at_least(1, workers=self.workers)
        from dexnudge.experiments.reproduction import reproduce

        with counted("reproducing") as show:

            def recorded(record: "TrialRecord", finished: int, total: int) -> None:
                show(finished, total, description=f"{record.scene}, {record.method}")

            report = reproduce(self._config(), Path(self.out), workers=self.workers, on_record=recorded)
        say(report, f"written: {self.out}")
        return 0

    def _config(self) -> "ReproductionConfig":
        from dexnudge.experiments.config import ExperimentConfig
        from dexnudge.experiments.reproduction import FULL_NUM, QUICK_NUM, QUICK_OBJECTS, ReproductionConfig

        num, max_objects = (QUICK_NUM, QUICK_OBJECTS) if self.quick else (FULL_NUM, None)
        common = settings(
            ExperimentConfig,
            self,
            methods=ExperimentConfig.methods,  # each part has its own
            max_objects=max_objects if self.max_objects is None else self.max_objects,
            num=num if self.num is None else self.num,
        )
        models = named_folders("prediction_weights", self.prediction_weights)
        return settings(ReproductionConfig, self, common=common, prediction_weights=models)
