"""`dexnudge scene`: what is understood of a scene, before anything is sampled."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dexnudge.cli.arguments import Flag, OptionalFolder, out_folder, say
from dexnudge.cli.scene_options import RUNS, SceneOptions, say_findings, stop_at_errors

if TYPE_CHECKING:
    from dexnudge.finding import Finding

FINDINGS, PICTURE, PAGE = "findings.json", "scene.png", "scene.html"


@dataclass(frozen=True, kw_only=True)
class SceneCommand(SceneOptions):
    """Show what is understood of a scene: sizes, supports, the way that is free, room for fingers, and what is wrong.

    Takes what `sample` takes, and writes a folder that `sample` takes as its OBJECT, with a picture and a page. With an
    error among the findings the exit code is 2; the folder is written all the same, to be looked at.
    """

    out: OptionalFolder = None
    """Folder to write; unless given runs/OBJECT-SCENE-understood, numbered where that is taken."""
    overwrite: Flag = False
    """Replace an existing scene folder; other files in it stay."""

    def run(self) -> int:
        """Understand, write, print."""
        self.check_options()
        from dexnudge.hands.registry import load_hand
        from dexnudge.jobs.folders import new_folder
        from dexnudge.scenes.files import SCENE_FILES
        from dexnudge.scenes.free_way import free_way
        from dexnudge.viewer.picture import write_png
        from dexnudge.viewer.scene_view import along_motion, scene_picture, scene_view, write_scene_page

        default = RUNS / f"{self.label}-{self.place}-understood"
        out = out_folder(self.out, default, overwrite=self.overwrite)
        ours = (*SCENE_FILES, PICTURE, PAGE)
        with new_folder(out, overwrite=self.overwrite, marker=FINDINGS, ours=ours) as folder:
            name, scene = self.build()
            findings = scene.findings(load_hand(self.hand, base=self.base))
            scene.save(folder)
            _write(findings, folder / FINDINGS)
            view = scene_view(scene, None if scene.misplaced else free_way(scene))
            write_png(scene_picture(view), folder / PICTURE)
            write_scene_page(along_motion(scene, view), folder / PAGE, title=f"{name}, {scene.name}", findings=findings)
        say_findings(findings, SceneCommand)
        say(f"written: {out}")
        stop_at_errors(findings)
        return 0


def _write(findings: Sequence[Finding], path: Path) -> None:
    text = json.dumps({"findings": [finding.as_dict() for finding in findings]}, indent=2)
    path.write_text(text + "\n", encoding="utf-8")
