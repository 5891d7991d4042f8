"""`dexnudge dataset generate|info|check`: grasps and non-prehensile configurations to learn from."""

import shlex
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

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
    say,
    settings,
    stdout,
    table,
)
from dexnudge.errors import InputError

if TYPE_CHECKING:
    from dexnudge.dataset.info import DatasetInfo


@dataclass(frozen=True, kw_only=True)
class Generate(EngineOptions, SetOptions):
    """Generate verified configurations for a set of objects; a stopped run keeps the objects that are done."""

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
        from dexnudge.synthesis.dataset_card import write_card
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
        info = describe(self.out)
        _print(info, self.out, _as_page(info, self.out, self.objects))
        return 0


@dataclass(frozen=True)
class Info:
    """Count what a dataset holds and how it is spread; with --out also draw it as a page."""

    folder: ResultFolder
    """Folder that `dataset generate` wrote."""
    out: OptionalFolder = None
    """Folder for dataset.html (tables, charts, pictures of random samples) and samples-BEHAVIOUR.png; of objects of one's
    own with --objects."""
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

        info = describe(self.folder)
        _print(info, self.folder, "" if self.out else _as_page(info, self.folder))
        if self.out is not None:
            from dexnudge.jobs.folders import owned_folder
            from dexnudge.synthesis.dataset_page import draw_samples, write_dataset_page

            with owned_folder(self.out):
                samples = draw_samples(self.folder, objects=self.objects, seed=self.seed)
                print("\nwrote " + "\n      ".join(map(str, write_dataset_page(info, samples, self.out))))
        return 0


def _as_page(info: "DatasetInfo", folder: str, objects: str = "SET") -> str:
    """Return what to type for a dataset's page; objects: the set that it was generated from."""
    from dexnudge.synthesis.dataset_card import builtin_set

    own = [] if builtin_set(info.manifest) else ["--objects", objects]
    return f"; as a page: {shlex.join(['dexnudge', 'dataset', 'info', folder, *own, '--out', 'NAME'])}"


def _print(info: "DatasetInfo", folder: str, more: str) -> None:
    """Print what most want to know of a dataset, and `more` in the last line; its card and its page hold the rest."""
    from dexnudge.synthesis.dataset_card import CARD_FILE, description

    say(description(info).summary)
    shown = table("behaviour", "attempted", "kept", "kept [%]", "failed", "median margin", "rejected most often for")
    shown.columns[-1].justify = "left"
    margins = {row[0]: row[3] for row in info.tables["margin"].rows} if "margin" in info.tables else {}
    for name, count in info.counts.items():
        share = f"{100 * count.kept / count.attempted:.1f}" if count.attempted else "-"
        reason, number = max(count.rejected.items(), key=itemgetter(1), default=("-", 0))
        why = f"{reason}: {number}" if number else "-"
        numbers = (count.attempted, count.kept, share, count.failed, margins.get(name, "-"), why)
        shown.add_row(name, *map(str, numbers))
    stdout().print(shown)
    say(f"digits, directions, faces, joints and more: {Path(folder) / CARD_FILE}{more}")


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
    """The set of objects that it was generated from; with --num not needed for built-in objects."""
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
        if self.num is None:
            refuse_without("num", self, "seed")
        from dexnudge.dataset.manifest import read_manifest
        from dexnudge.synthesis.dataset_card import builtin_set
        from dexnudge.synthesis.recheck import check_dataset

        own = None if self.objects else builtin_set(read_manifest(self.folder))
        objects = own if self.num is not None and own else self.objects
        if objects is None:
            refuse_without("objects", self, "num")
        report = check_dataset(Path(self.folder), objects=objects, num=self.num, seed=self.seed, workers=self.workers)
        if report.differences:
            raise InputError(
                f"{self.folder}: does not hold what it says, {len(report.differences)} differences:\n"
                f"{listed(report.differences)}\nexpected all to agree; generate again"
            )
        read = f"{report.rows} configurations of {report.objects} objects read"
        if objects is None:
            print(f"{read}; none verified again: --objects {own or 'SET'} verifies them")
        else:
            print(f"{read}, {report.verified} verified again: all agree")
        return 0
