"""`dexnudge dataset generate|info|check`: grasps and non-prehensile configurations to learn from."""

from dataclasses import dataclass
from pathlib import Path

from dexnudge.cli.arguments import (
    Count,
    EngineOptions,
    OptionalCount,
    OptionalFolder,
    OptionalSet,
    ResultFolder,
    SetOptions,
    check_at_least,
    listed,
    refuse_without,
    settings,
)
from dexnudge.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Generate(EngineOptions, SetOptions):
    """Generate verified configurations for a set of objects; a stopped run goes on where it was."""

    non_prehensile: Count = 256
    """Attempts at pushing, pressing and hooking for each object."""
    grasps: Count = 256
    """Attempts at grasps for each object."""
    upright: float = 0.0
    """Share of the objects that stand on their end, as books do; the others lie."""

    def run(self) -> int:
        """Generate what is missing, write the data card and print the counts."""
        check_at_least(0, seed=self.seed, non_prehensile=self.non_prehensile, grasps=self.grasps)
        check_at_least(1, workers=self.workers)
        from dexnudge.dataset.info import describe
        from dexnudge.jobs.folders import owned_folder
        from dexnudge.synthesis.dataset_card import description, write_card
        from dexnudge.synthesis.generate import generate_dataset
        from dexnudge.synthesis.object_data import GenerationConfig

        with owned_folder(self.out) as out:
            generate_dataset(
                self.objects,
                out,
                settings(GenerationConfig, self),
                seed=self.seed,
                workers=self.workers,
                engine=self.engine,
                ray_address=self.ray_address,
            )
            write_card(self.out)
        print(description(describe(self.out)).text(), end="")
        return 0


@dataclass(frozen=True)
class Info:
    """Count what a dataset holds and how it is spread; with --out also draw it as a page."""

    folder: ResultFolder
    """Folder that `dataset generate` wrote."""
    out: OptionalFolder = None
    """Folder for dataset.html (tables, charts, pictures of random samples) and samples-BEHAVIOUR.png."""
    objects: OptionalSet = None
    """The set of objects that it was generated from, for the pictures; not needed for built-in objects."""
    seed: Count = 0
    """Which samples are drawn."""

    def run(self) -> int:
        """Print the tables and write the page."""
        check_at_least(0, seed=self.seed)
        if self.out is None:
            refuse_without("out", self, "objects", "seed")
        from dexnudge.dataset.info import describe
        from dexnudge.synthesis.dataset_card import description

        info = describe(self.folder)
        print(description(info).text(), end="")
        if self.out is not None:
            from dexnudge.jobs.folders import owned_folder
            from dexnudge.synthesis.dataset_page import draw_samples, write_dataset_page

            with owned_folder(self.out):
                samples = draw_samples(self.folder, objects=self.objects, seed=self.seed)
                print("\nwrote " + "\n      ".join(map(str, write_dataset_page(info, samples, self.out))))
        return 0


@dataclass(frozen=True)
class LabelTurns:
    """Judge which configurations of an older dataset can turn or tip their object; a stopped run goes on where it was."""

    folder: ResultFolder
    """Folder that `dataset generate` wrote, whose shards are written again."""
    objects: OptionalSet = None
    """The set of objects that it was generated from; not needed for built-in objects."""
    workers: Count = 2
    """Processes; one core each."""

    def run(self) -> int:
        """Judge, write the shards and the data card, and print how many were written."""
        check_at_least(1, workers=self.workers)
        from dexnudge.jobs.folders import owned_folder
        from dexnudge.synthesis.dataset_card import write_card
        from dexnudge.synthesis.recheck import label_turns

        with owned_folder(self.folder):
            written = label_turns(Path(self.folder), objects=self.objects, workers=self.workers)
            write_card(self.folder)
        print(f"{written} shards judged")
        return 0


@dataclass(frozen=True)
class CheckDataset:
    """Read every shard of a dataset and, with --objects, verify its configurations again from the meshes."""

    folder: ResultFolder
    """Folder that `dataset generate` wrote."""
    objects: OptionalSet = None
    """The set of objects that it was generated from."""
    num: OptionalCount = None
    """Verify only so many configurations, drawn at random; all unless given."""
    seed: Count = 0
    """Which ones."""
    workers: Count = 2
    """Processes; one core each."""

    def run(self) -> int:
        """Print what was checked; InputError when something does not hold."""
        check_at_least(0, seed=self.seed, num=self.num)
        check_at_least(1, workers=self.workers)
        if self.objects is None:
            refuse_without("objects", self, "num")
        if self.num is None:
            refuse_without("num", self, "seed")
        from dexnudge.synthesis.recheck import check_dataset

        report = check_dataset(
            Path(self.folder), objects=self.objects, num=self.num, seed=self.seed, workers=self.workers
        )
        if report.differences:
            raise InputError(
                f"{self.folder}: does not hold what it says, {len(report.differences)} differences:\n"
                f"{listed(report.differences)}\nexpected all to agree; generate again"
            )
        print(
            f"{report.rows} configurations of {report.objects} objects read, {report.verified} verified again: all agree"
        )
        return 0
