"""`dexnudge execute`: verified configurations played out in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from dexnudge.cli.arguments import Count, OptionalFolder, check_at_least, metavar


@dataclass(frozen=True)
class Execute:
    """Play the best verified configurations out in MuJoCo: close in, squeeze, push by the scene's motion length.

    A push succeeds if the object advances 80 % of the way, turns less than 15 degrees and is not dropped, and the hand
    never gets deeper than 2 mm into the surroundings.
    """

    folder: tyro.conf.Positional[Annotated[str, metavar("DIR")]]
    """Folder that `sample` wrote."""
    top: Count = 1
    """Execute this many, best first."""
    workers: Count = 2
    """Processes; one core each."""
    out: OptionalFolder = None
    """Folder to write; DIR/execution unless given."""
    overwrite: bool = False
    """Replace an existing folder of an earlier execution."""

    def run(self) -> int:
        """Execute, write, print."""
        check_at_least(1, top=self.top, workers=self.workers)
        from dexnudge.execution.folder import FOLDER, execute_folder
        from dexnudge.jobs.progress import progress

        folder = Path(self.folder)
        out = folder / FOLDER if self.out is None else Path(self.out)
        with progress() as bars:
            bar = bars.add_task("executing", total=None)
            summary = execute_folder(
                folder,
                top=self.top,
                workers=self.workers,
                out=out,
                overwrite=self.overwrite,
                on_done=lambda *_: bars.advance(bar),
            )
        _print(summary, out)
        return 0


def _print(summary: dict[str, Any], out: Path) -> None:
    from dexnudge.cli.console import stdout, table

    shown = table("configuration", "outcome", "advanced [mm]", "turned [deg]", "hand in surroundings [mm]")
    for row in summary["configurations"]:
        figures = ["", "", ""]
        if "advanced" in row:
            figures = [
                f"{1e3 * row['advanced']:.1f}",
                f"{row['turned_deg']:.1f}",
                f"{1e3 * row['hand_environment']:.2f}",
            ]
        shown.add_row(str(row["configuration"]), row["reason"] or "success", *figures)
    console = stdout()
    console.print(shown)
    console.print(f"{summary['succeeded']} of {summary['attempted']} succeed")
    console.print(f"written: {out}", soft_wrap=True)
    console.print(f"look at it: python -m mujoco.viewer --mjcf={out / 'scene.xml'}", soft_wrap=True)
