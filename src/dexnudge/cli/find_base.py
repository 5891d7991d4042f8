"""`dexnudge find-base`: where an arm may stand to execute the configurations of a result folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dexnudge.cli.arguments import (
    NOTHING_SUCCEEDED,
    Flag,
    OptionalFolder,
    ResultFolder,
    counted,
    metavar,
    out_folder,
    say,
    stdout,
    table,
)
from dexnudge.cli.arm_options import MountOptions

if TYPE_CHECKING:
    from dexnudge.trajectories.base_map import BaseMap

SHOWN = 5  # places in the table


@dataclass(frozen=True, kw_only=True)
class FindBase(MountOptions):
    """Map the places around an object from which an arm reaches the verified configurations, along the motion.

    The base stands upright and faces the object. Writes base_map.png, base_map.npz and, of the best place, arm_base.json,
    which --arm-base takes. What the arm would do between these places is not looked at. Exit code 3: no place reaches
    anything.
    """

    folder: ResultFolder
    """Folder that `sample` wrote."""
    arm: Annotated[str, metavar("NAME_OR_FILE")]
    """Built-in arm, or a URDF or MJCF file; an unknown name lists them."""
    heights: Annotated[tuple[float, ...], metavar("Z...")] = (0.0,)
    """Heights of the base over the object's underside [m]; a map for each."""
    extent: Annotated[float, metavar("X")] = 0.9
    """Of the map from the object, either way [m]."""
    step: Annotated[float, metavar("X")] = 0.1
    """From one place to the next [m]."""
    out: OptionalFolder = None
    """Folder to write; unless given DIR/base, numbered where that is taken."""
    overwrite: Flag = False
    """Replace the folder of an existing map."""

    def run(self) -> int:
        """Map, write, print."""
        from dexnudge.results.folder import load_samples
        from dexnudge.trajectories.base_map import find_base, map_folder

        arm, mount = self.loaded(self.arm), self.T_flange_mount()  # what is wrong with them is said before samples load
        out = out_folder(self.out, Path(self.folder) / "base", overwrite=self.overwrite)
        with map_folder(out, overwrite=self.overwrite) as folder, counted("places") as show:
            found = find_base(
                load_samples(self.folder),
                arm,
                mount=mount,
                heights=self.heights,
                extent=self.extent,
                step=self.step,
                on_progress=show,
            )
            found.write(folder)
        _print(found)
        say(f"written: {out}")
        if not (out / "base_map.png").is_file():
            say("a picture of the map needs matplotlib: pip install 'dexnudge[plots]'")
        if not found.best():
            return NOTHING_SUCCEEDED
        say(f"use it: --arm {self.arm} --arm-base {out / 'arm_base.json'}")
        return 0


def _print(found: BaseMap) -> None:
    import numpy as np

    say(repr(found))
    shown = table("place", "x [m]", "y [m]", "z [m]", "yaw [deg]", "share", "mean margin")
    for number, place in enumerate(found.best(SHOWN)):
        pose = found.pose(*place)
        yaw = np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))
        numbers = [f"{value:.2f}" for value in pose[:3, 3]]
        row = (*numbers, f"{yaw:.0f}", f"{found.share[place]:.0%}", f"{found.margin[place]:.2f}")
        shown.add_row(str(number + 1), *row)
    if shown.row_count:
        stdout().print(shown)
