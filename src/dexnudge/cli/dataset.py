"""`dexnudge dataset generate|info|check`: grasps and non-prehensile configurations to learn from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dexnudge.cli.arguments import Count, Folder, OptionalNumber, Text, Units, check_at_least, metavar
from dexnudge.errors import InputError


@dataclass(frozen=True)
class Generate:
    """Generate verified configurations for a set of objects; a stopped run goes on where it was."""

    objects: Annotated[str, metavar("SET")]
    """builtin:train, folder of meshes, text file of paths, or a DexGraspNet meshdata folder (scale 0.08)."""
    out: Folder
    """Folder of the dataset."""
    seed: Count = 0
    """Each object gets a seed derived from it."""
    workers: Count = 2
    """Processes; one core each."""
    units: Units = "m"
    """Unit of the numbers in mesh files."""
    length: OptionalNumber = None
    """Scale every object so that its longest side has this length [m]."""
    hand: Text = "shadow_lite"
    """Built-in hand or URDF file."""
    non_prehensile: Count = 256
    """Attempts at pushing, pressing and hooking for each object."""
    grasps: Count = 256
    """Attempts at grasps for each object."""

    def run(self) -> int:
        """Generate what is missing and print the counts."""
        check_at_least(0, seed=self.seed, non_prehensile=self.non_prehensile, grasps=self.grasps)
        check_at_least(1, workers=self.workers)
        from dexnudge.dataset.info import describe
        from dexnudge.results.new_folder import check_writable_place
        from dexnudge.synthesis.generate import GenerationConfig, generate_dataset

        check_writable_place(self.out)
        generate_dataset(
            self.objects,
            Path(self.out),
            GenerationConfig(
                hand=self.hand,
                units=self.units,
                length=self.length,
                non_prehensile=self.non_prehensile,
                grasps=self.grasps,
            ),
            seed=self.seed,
            workers=self.workers,
        )
        print(describe(self.out).table(), end="")
        return 0


@dataclass(frozen=True)
class Info:
    """Count what a dataset holds: configurations by behaviour, rejections, digits, directions."""

    folder: tyro.conf.Positional[Annotated[str, metavar("DIR")]]
    """Folder that `dataset generate` wrote."""

    def run(self) -> int:
        """Print the counts."""
        from dexnudge.dataset.info import describe

        print(describe(self.folder).table(), end="")
        return 0


@dataclass(frozen=True)
class CheckDataset:
    """Read every shard of a dataset and, with --objects, verify some of its configurations again."""

    folder: tyro.conf.Positional[Annotated[str, metavar("DIR")]]
    """Folder that `dataset generate` wrote."""
    objects: Annotated[str | None, metavar("SET")] = None
    """The set of objects that it was generated from."""
    num: Count = 64
    """Configurations to verify again, spread over the objects."""
    seed: Count = 0
    """Which ones."""

    def run(self) -> int:
        """Print what was checked; InputError when something does not hold."""
        check_at_least(0, seed=self.seed, num=self.num)
        from dexnudge.synthesis.checking import check_dataset

        report = check_dataset(Path(self.folder), objects=self.objects, num=self.num, seed=self.seed)
        if report.differences:
            listed = "\n".join(f"  {difference}" for difference in report.differences)
            raise InputError(
                f"{self.folder}: does not hold what it says:\n{listed}\nexpected all to agree; generate again"
            )
        print(
            f"{report.rows} configurations of {report.objects} objects read, {report.verified} verified again: all agree"
        )
        return 0


@dataclass(frozen=True)
class Dataset:
    """Generate, count and check configurations to learn from."""

    action: (
        Annotated[Generate, tyro.conf.subcommand("generate")]
        | Annotated[Info, tyro.conf.subcommand("info")]
        | Annotated[CheckDataset, tyro.conf.subcommand("check")]
    )

    def run(self) -> int:
        """Run the chosen one."""
        return self.action.run()
