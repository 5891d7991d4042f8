"""The built-in phone on a table, between layers and in a shelf: verified configurations, 3-D pages and pictures."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

import dexnudge as dn
from dexnudge.cli.arguments import stdout, table


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
    """Seed of scenes and draws."""

    def run(self) -> None:
        """Write the folders, then print the table."""
        shown = table("scene", "drawn", "verified", "robust", "best margin", "seconds", "picture and 3-D page")
        sampler = dn.Sampler(dn.load_hand("shadow_lite"))
        for family in self.scenes:
            start = time.perf_counter()
            scene = dn.build_scene(family, self.object, seed=self.seed)
            samples = sampler.sample(scene, num=self.num, seed=self.seed)
            out = self.out / family
            samples = samples.save(out, title=f"{self.object}, {family}", overwrite=True)
            shown.add_row(
                family,
                str(len(samples)),
                str(samples.num_verified),
                str(int(samples.verdicts.robust.sum())),
                f"{samples[0].force_margin:.2f}" if samples.num_verified else "-",
                f"{time.perf_counter() - start:.1f}",
                f"{out}/view.png, view.html",
            )
        console = stdout()
        console.print(f"{self.object}: hand configurations verified by exact geometry and force balance")
        console.print(shown)


if __name__ == "__main__":
    try:
        tyro.cli(Demo).run()
    except dn.DexnudgeError as error:
        sys.exit(f"demo: {error}")
