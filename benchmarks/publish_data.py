"""Writes the README's lines about a dataset, and the pictures beside them, from the dataset alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dexnudge.dataset.info import DatasetInfo, describe
from dexnudge.synthesis.dataset_page import draw_samples, write_dataset_page

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- data:begin -->", "<!-- data:end -->"


@dataclass(frozen=True)
class PublishData:
    """Write the dataset's lines in the README and the pictures of random samples in docs/images."""

    dataset: Annotated[Path, tyro.conf.Positional]
    """Folder that `dexnudge dataset generate` wrote, below the repository's root."""
    seed: int = 0
    """Which samples are drawn."""

    def run(self) -> None:
        """Write both."""
        info = describe(self.dataset)
        readme = ROOT / "README.md"
        before, rest = readme.read_text(encoding="utf-8").split(BEGIN)
        after = rest.split(END)[1]
        place = self.dataset.resolve().relative_to(ROOT).as_posix()
        readme.write_text(f"{before}{BEGIN}\n{lines(info, place)}\n{END}{after}", encoding="utf-8")
        samples = draw_samples(self.dataset, seed=self.seed)
        for path in write_dataset_page(info, samples, ROOT / "demo" / "dataset"):
            if path.suffix == ".png":
                path.replace(ROOT / "docs" / "images" / path.name)


def lines(info: DatasetInfo, place: str) -> str:
    """What the dataset holds and how much of what was tried."""
    grasps = info.counts["grasp"]
    others = [count for behaviour, count in info.counts.items() if behaviour != "grasp"]
    kept, attempted = sum(count.kept for count in others), sum(count.attempted for count in others)
    return (
        f"[`{place}`]({place}/README.md): {kept:,} pushes, presses and hooks ({100 * kept / attempted:.0f} % of what was "
        f"tried) and {grasps.kept:,} grasps that hold in MuJoCo ({100 * grasps.kept / grasps.attempted:.0f} %), on "
        f"{info.num_objects} generated objects, {info.bytes_on_disk / 1e6:.0f} MB."
    )


if __name__ == "__main__":
    tyro.cli(PublishData).run()
