"""The built-in phone on a table, between layers and in a shelf: verified configurations, 3-D pages and pictures."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.cli.sample import Sample
from dexnudge.errors import DexnudgeError


@dataclass(frozen=True)
class Demo:
    """Sample for one object in several scenes and print one table."""

    out: Path = Path("demo")
    """Folder with one result folder for each scene; those of an earlier run are replaced."""
    object: str = "phone"
    """Mesh file or name of a built-in object."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    num: int = 32
    """Draws for each scene."""
    seed: int = 0
    """Of scenes and draws."""

    def run(self) -> None:
        """Write the folders, then print the table."""
        shown = table("scene", "drawn", "verified", "robust", "best margin", "seconds", "picture and 3-D page")
        for scene in self.scenes:
            start = time.perf_counter()
            out = self.out / scene
            summary = Sample(
                object=self.object, scene=scene, out=str(out), num=self.num, seed=self.seed, overwrite=True
            ).write()
            best = summary["best_force_margin"]
            shown.add_row(
                scene,
                str(summary["drawn"]),
                str(summary["verified"]),
                str(summary["robust"]),
                "-" if best is None else f"{best:.2f}",
                f"{time.perf_counter() - start:.1f}",
                f"{out}/view.png, view.html",
            )
        console = stdout()
        console.print(f"{self.object}: hand configurations verified by exact geometry and force balance")
        console.print(shown)


if __name__ == "__main__":
    try:
        tyro.cli(Demo).run()
    except DexnudgeError as error:
        sys.exit(f"demo: {error}")
