"""`dexnudge execute`: verified configurations played out in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from dexnudge.cli.arguments import Count, OptionalFolder, check_at_least, metavar
from dexnudge.errors import InputError


@dataclass(frozen=True)
class Execute:
    """Play the best verified configurations out in MuJoCo: close in, squeeze, push by the scene's motion length.

    A push succeeds if the object advances 80 % of the way, turns less than 15 degrees and is not dropped, and the hand
    never gets deeper than 2 mm into the surroundings. With --then-grasp the object is pushed until it can be grasped,
    grasped, lifted by 10 cm and held for 2 s, in one continuous simulation.
    """

    folder: tyro.conf.Positional[Annotated[str, metavar("DIR")]]
    """Folder that `sample` wrote."""
    top: Count = 1
    """Execute this many, best first."""
    workers: Count = 2
    """Processes; one core each."""
    then_grasp: bool = False
    """Slide, grasp and lift."""
    attempts: Count = 3
    """With --then-grasp: most attempts; each goes on from where the one before left hand and object."""
    seed: Count = 0
    """With --then-grasp: of the grasps."""
    weights: OptionalFolder = None
    """With --then-grasp: folder of the model; the shipped one unless given."""
    out: OptionalFolder = None
    """Folder to write; DIR/execution unless given, with --then-grasp DIR/slide_grasp_lift."""
    overwrite: bool = False
    """Replace an existing folder of an earlier execution."""
    films: Count = 1
    """Draw film.png and film.gif of the first N, which takes some seconds each; the page film.html is of each."""

    def run(self) -> int:
        """Execute, write, print."""
        check_at_least(1, top=self.top, workers=self.workers, attempts=self.attempts)
        check_at_least(0, seed=self.seed, films=self.films)
        if self.then_grasp:
            return self._then_grasp()
        from dexnudge.execution.folder import PUSH_FOLDER, push_folder
        from dexnudge.jobs.progress import progress

        folder = Path(self.folder)
        out = folder / PUSH_FOLDER if self.out is None else Path(self.out)
        with progress() as bars:
            bar = bars.add_task("executing", total=None)
            summary = push_folder(
                folder,
                top=self.top,
                workers=self.workers,
                out=out,
                overwrite=self.overwrite,
                films=self.films,
                on_done=lambda *_: bars.advance(bar),
            )
        _print_pushes(summary, out)
        return 0

    def _then_grasp(self) -> int:
        if self.top != 1:
            raise InputError(
                f"--top is {self.top} with --then-grasp, which goes through the configurations by itself, best first; "
                "expected no --top; use --attempts"
            )
        from dexnudge.execution.folder import LIFT_FOLDER, lift_folder
        from dexnudge.jobs.progress import progress

        folder = Path(self.folder)
        out = folder / LIFT_FOLDER if self.out is None else Path(self.out)
        with progress() as bars:
            bars.add_task("slide, grasp, lift", total=None)
            summary = lift_folder(
                folder,
                attempts=self.attempts,
                seed=self.seed,
                weights=self.weights,
                out=out,
                overwrite=self.overwrite,
                films=self.films > 0,
            )
        _print_attempts(summary, out)
        return 0


def _print_pushes(summary: dict[str, Any], out: Path) -> None:
    from dexnudge.cli.arguments import stdout, table

    shown = table("configuration", "outcome", "moved [mm]", "turned [deg]", "hand in surroundings [mm]")
    for row in summary["configurations"]:
        figures = ["", "", ""]
        if "length_reached" in row:
            figures = [
                f"{1e3 * row['length_reached']:.1f} of {1e3 * row['length_asked']:.0f}",
                f"{row['turned_deg']:.1f}",
                f"{1e3 * row['hand_environment']:.2f}",
            ]
        shown.add_row(str(row["configuration"]), _outcome(row), *figures)
    console = stdout()
    console.print(shown)
    console.print(f"{summary['succeeded']} of {summary['attempted']} succeed")
    _print_where(out)


def _print_attempts(summary: dict[str, Any], out: Path) -> None:
    from dexnudge.cli.arguments import stdout, table

    shown = table("attempt", "slid by", "moved [mm]", "overhang", "grasps", "raised [mm]", "outcome")
    for row in summary["attempts"]:
        moved = row["length_reached"]
        shown.add_row(
            str(row["number"]),
            "" if row["configuration"] < 0 else str(row["configuration"]),
            "" if moved is None else f"{1e3 * moved:.0f} of {1e3 * row['length_asked']:.0f}",
            "" if row["overhang"] is None else f"{row['overhang']:.0%}",
            "" if row["grasps"] < 0 else f"{row['grasps']} of {row['drawn']}",
            "" if row["raised"] is None else f"{1e3 * row['raised']:.0f}",
            f"{row['phase']}: {_outcome(row)}" if row["phase"] else "lifted and held",
        )
    console = stdout()
    console.print(shown)
    first = "yes" if summary["success_first_attempt"] else "no"
    console.print(f"success: {'yes' if summary['success'] else 'no'}; at the first attempt: {first}")
    if summary["ended"]:
        from dexnudge.planning.outcomes import Outcome

        console.print(f"no further attempt: {Outcome(summary['ended']).sentence}", soft_wrap=True)
    _print_where(out)


def _outcome(row: dict[str, Any]) -> str:
    from dexnudge.planning.outcomes import Outcome

    detail = f" ({row['detail']})" if row["detail"] else ""
    return Outcome(row["outcome"]).sentence + detail


def _print_where(out: Path) -> None:
    from dexnudge.cli.arguments import stdout
    from dexnudge.execution.film import PAGE_FILE

    console = stdout()
    console.print(f"written: {out}", soft_wrap=True)
    for film in sorted(out.glob(f"*/{PAGE_FILE}"))[:1]:
        console.print(f"watch it: {film}", soft_wrap=True)
    console.print(f"open the model: python -m mujoco.viewer --mjcf={out / 'scene.xml'}", soft_wrap=True)
