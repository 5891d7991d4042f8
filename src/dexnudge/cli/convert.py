"""`dexnudge convert`: results, scenes and executions as files of other tools, and their grasps verified here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dexnudge.cli.arguments import (
    NOTHING_SUCCEEDED,
    Flag,
    Folder,
    OptionalFolder,
    OptionalNumber,
    Text,
    counted,
    given,
    metavar,
    say,
)
from dexnudge.errors import InputError


@dataclass(frozen=True)
class Convert:
    """Write files for other tools, or read theirs.

    From a folder that `sample` wrote: dexgraspnet, bodex, dexgraspbench (verified configurations), usd and mujoco (one file;
    also of a scene folder). From a folder with executions: lerobot (v3.0). From a .npy file of DexGraspNet, BODex or
    DexGraspBench, or a folder of the last for one object: dexnudge, a result folder with all of its hands verified in
    --scene. Exit code 3: everything is written, but nothing of it is verified.
    """

    source: tyro.conf.Positional[Annotated[str, metavar("IN")]]
    """Folder or file to read."""
    to: Text = tyro.MISSING
    """Format; an unknown name lists them."""
    out: Folder = tyro.MISSING
    """Folder to write; of usd (.usda, .usdc, .usd) and mujoco (.xml) a file."""
    every: Flag = False
    """Also write configurations that are not verified."""
    scene: OptionalFolder = None
    """With dexnudge: scene folder, or result folder, in which the hands stand."""
    hand: Text = "shadow_lite"
    """With dexnudge: built-in hand or description that the file's joints belong to."""
    base: Flag = True
    """With dexnudge: leave the forearm out of the hand's geometry."""
    scale: OptionalNumber = None
    """With dexnudge: take the grasps of a DexGraspNet file that are of the object at this scale."""

    def run(self) -> int:
        """Convert, print."""
        from dexnudge.formats.conversion import BACK, convert

        if self.to == BACK:
            return self._read_back()
        for name in given(self, "scene", "hand", "base", "scale"):
            raise InputError(
                f"`{name}` is given with the format {self.to}; expected it with {BACK} alone; leave it out"
            )
        written = convert(Path(self.source), self.to, Path(self.out), every=self.every)
        say(f"written: {self.out}: {written}")
        return 0

    def _read_back(self) -> int:
        from dexnudge.formats.conversion import read_back
        from dexnudge.hands.registry import load_hand
        from dexnudge.scenes.scene import Scene

        if self.scene is None:
            raise InputError("no `scene` is given; expected the folder of the scene in which the hands stand")
        scene, hand = Scene.load(self.scene), load_hand(self.hand, base=self.base)
        scene.validate()
        with counted("verifying") as show:
            samples = read_back(Path(self.source), scene, hand, scale=self.scale, on_verified=show)
        samples.save(self.out)
        say(repr(samples), f"written: {self.out}")
        return 0 if samples.num_verified else NOTHING_SUCCEEDED
