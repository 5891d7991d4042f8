"""`dexnudge dataset generate|info|check`: grasps and non-prehensile configurations to learn from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dexnudge.cli.arguments import (
    Count,
    Folder,
    OptionalCount,
    OptionalFolder,
    OptionalNumber,
    Text,
    Units,
    check_at_least,
    metavar,
)
from dexnudge.errors import InputError

LISTED_DIFFERENCES = 20  # of a check; as many as fit on a screen


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
    engine: Literal["processes", "ray"] = "processes"
    """Processes of this machine, or a Ray cluster (needs dexnudge[cluster])."""
    ray_address: Annotated[str | None, metavar("HOST:PORT")] = None
    """A running Ray cluster; without it, one with --workers cores is started on this machine."""

    def run(self) -> int:
        """Generate what is missing, write the data card and print the counts."""
        check_at_least(0, seed=self.seed, non_prehensile=self.non_prehensile, grasps=self.grasps)
        check_at_least(1, workers=self.workers)
        from dexnudge.dataset.info import describe
        from dexnudge.dataset.tables import report
        from dexnudge.jobs.folders import owned_folder
        from dexnudge.synthesis.data_card import write_card
        from dexnudge.synthesis.generate import generate_dataset
        from dexnudge.synthesis.object_task import GenerationConfig

        config = GenerationConfig(
            hand=self.hand,
            units=self.units,
            length=self.length,
            non_prehensile=self.non_prehensile,
            grasps=self.grasps,
        )
        with owned_folder(self.out) as out:
            generate_dataset(
                self.objects,
                out,
                config,
                seed=self.seed,
                workers=self.workers,
                engine=self.engine,
                ray_address=self.ray_address,
            )
            write_card(self.out)
        print(report(describe(self.out)), end="")
        return 0


@dataclass(frozen=True)
class Info:
    """Count what a dataset holds and how it is spread; with --out also draw it as a page."""

    folder: tyro.conf.Positional[Annotated[str, metavar("DIR")]]
    """Folder that `dataset generate` wrote."""
    out: OptionalFolder = None
    """Folder for dataset.html (tables, charts, pictures of random samples) and samples-BEHAVIOUR.png."""
    objects: Annotated[str | None, metavar("SET")] = None
    """The set of objects that it was generated from, for the pictures; not needed for built-in objects."""
    seed: Count = 0
    """Which samples are drawn."""

    def run(self) -> int:
        """Print the tables and write the page."""
        check_at_least(0, seed=self.seed)
        from dexnudge.dataset.info import describe
        from dexnudge.dataset.tables import report

        info = describe(self.folder)
        print(report(info), end="")
        if self.out is not None:
            from dexnudge.jobs.folders import owned_folder
            from dexnudge.synthesis.dataset_page import draw_samples, write_dataset_page

            with owned_folder(self.out):
                samples = draw_samples(self.folder, objects=self.objects, seed=self.seed)
                print("\nwrote " + "\n      ".join(map(str, write_dataset_page(info, samples, self.out))))
        return 0


@dataclass(frozen=True)
class CheckDataset:
    """Read every shard of a dataset and, with --objects, verify its configurations again from the meshes."""

    folder: tyro.conf.Positional[Annotated[str, metavar("DIR")]]
    """Folder that `dataset generate` wrote."""
    objects: Annotated[str | None, metavar("SET")] = None
    """The set of objects that it was generated from."""
    num: OptionalCount = None
    """Verify only so many configurations, drawn at random; all unless given."""
    seed: Count = 0
    """Which ones."""
    workers: Count = 2
    """Processes; one core each."""

    def run(self) -> int:
        """Print what was checked; InputError when something does not hold."""
        check_at_least(0, seed=self.seed)
        check_at_least(1, workers=self.workers)
        if self.num is not None:
            check_at_least(0, num=self.num)
        from dexnudge.synthesis.checking import check_dataset

        report = check_dataset(
            Path(self.folder), objects=self.objects, num=self.num, seed=self.seed, workers=self.workers
        )
        if report.differences:
            listed = [f"  {difference}" for difference in report.differences[:LISTED_DIFFERENCES]]
            if len(report.differences) > LISTED_DIFFERENCES:
                listed.append(f"  and {len(report.differences) - LISTED_DIFFERENCES} more")
            raise InputError(
                f"{self.folder}: does not hold what it says, {len(report.differences)} differences:\n"
                + "\n".join(listed)
                + "\nexpected all to agree; generate again"
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
