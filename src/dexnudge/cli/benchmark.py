"""`dexnudge benchmark`: fixed tasks that any method can enter, and one judge for all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dexnudge.cli.arguments import (
    Count,
    Flag,
    Folder,
    MeshOptions,
    OptionalSet,
    check_at_least,
    counted,
    metavar,
    refuse_without,
    say,
)


@dataclass(frozen=True)
class MakeBenchmark(MeshOptions):
    """Write the tasks of a suite: each a folder with scene and meshes, the hand, and a manifest with hashes.

    The same suite gives the same fingerprint on every machine; results can be compared where it is equal.
    """

    suite: tyro.conf.Positional[Annotated[str, metavar("SUITE")]]
    """Built-in suite (an unknown name lists them), or a YAML file."""
    out: Folder = tyro.MISSING
    """Folder to write."""
    objects: OptionalSet = None
    """Folder or list of meshes, or a DexGraspNet meshdata folder, for objects of the suite that are not built in."""
    overwrite: Flag = False
    """Replace an existing folder of tasks; other files in it stay."""

    def run(self) -> int:
        """Make, print."""
        from dexnudge.benchmark.suite import load_suite
        from dexnudge.benchmark.tasks import TASKS, make_tasks

        if self.objects is None:
            refuse_without("objects", self, "units", "length")
        suite = load_suite(self.suite)
        with counted("tasks") as show:
            made = make_tasks(
                suite,
                self.out,
                objects=self.objects,
                units=self.units,
                length=self.length,
                overwrite=self.overwrite,
                on_done=show,
            )
        say(*(f"not made: {name}: {reason}" for name, reason in made.not_made.items()))
        say(
            f"suite {suite.name}, version {suite.version}: {len(made.tasks)} tasks, at most {suite.draws} draws each, hand "
            f"{suite.hand}",
            f"fingerprint: {made.fingerprint}",
            f"written: {Path(self.out) / TASKS}",
        )
        return 0


@dataclass(frozen=True)
class ScoreBenchmark:
    """Judge entries by verification and in physics, and compare them on a page, in a table, a CSV and a chart.

    What an entry says of its own success is not read. Missing and malformed answers count as failures. Stopped runs go on
    where they were, and entries judged before are not judged again: give the same --out.
    """

    entries: tyro.conf.Positional[Annotated[tuple[str, ...], metavar("ENTRY...")]]
    """Folders of entries; docs/benchmark.md says what is in them."""
    suite: Folder = tyro.MISSING
    """Folder that `benchmark make` wrote."""
    out: Folder = tyro.MISSING
    """Folder of scores."""
    workers: Count = 2
    """Processes; one core each."""

    def run(self) -> int:
        """Judge what is missing, write and print the table."""
        check_at_least(1, workers=self.workers)
        from dexnudge.benchmark.score import score

        with counted("judging") as show:

            def judged(entry: str, done: int, total: int) -> None:
                show(done, total, description=entry)

            text = score(self.entries, self.suite, self.out, workers=self.workers, on_record=judged)
        say(text, f"written: {self.out}")
        return 0
