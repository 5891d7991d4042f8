"""Sampling in scans, judged in the true scenes: docs/data/scans.csv, docs/scans.md, a chart.

The rows of the page are executed on the whole set; the grid of errors is sampled with fewer objects and draws, and not
executed. Each size of the errors is a run of its own folder; what is there already is not run again.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tyro

from dexnudge.experiments.config import ExperimentConfig, ScanErrors
from dexnudge.experiments.metrics import Measured, measure, named
from dexnudge.experiments.records import FILE
from dexnudge.experiments.report import setting, write_report
from dexnudge.experiments.run import TrialRunner, read_run
from dexnudge.experiments.scan_trial import ScanTrial
from dexnudge.experiments.tables import AVAILABLE, INK, WIDTH, Table, csv_text, save_chart

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]
NOISE, TILT, POSE = (
    (0.0, 0.5, 1.0, 2.0),
    (0.0, 0.5, 2.0),
    ((0.0, 0.0), (2.0, 1.0), (4.0, 2.0)),
)  # [mm], [deg], [mm, deg]
EXPECTED = {"noise_mm": 1.0, "tilt_deg": 0.5, "pose_mm": 2.0, "pose_deg": 1.0}  # of a scan that was made with care
PAGE = {  # the rows of the page
    "the scene's own mesh": ScanErrors(triangle_mm=0.0, rounding_mm=0.0),
    "8 mm triangles, rounded to 0.01 mm, tilt 0.3 deg": ScanErrors(tilt_deg=0.3),
    "noise 1 mm": ScanErrors(noise_mm=1.0),
    "tilt 2 deg": ScanErrors(tilt_deg=2.0),
    "pose 2 mm, 1 deg": ScanErrors(pose_mm=2.0, pose_deg=1.0),
    "noise 1 mm, tilt 0.5 deg, pose 2 mm, 1 deg": ScanErrors(**EXPECTED),
    "noise 1 mm, tilt 0.5 deg, pose 4 mm, 2 deg": ScanErrors(noise_mm=1.0, tilt_deg=0.5, pose_mm=4.0, pose_deg=2.0),
    "noise 2 mm, tilt 2 deg, pose 4 mm, 2 deg": ScanErrors(noise_mm=2.0, tilt_deg=2.0, pose_mm=4.0, pose_deg=2.0),
    "three depth images": ScanErrors(depth_views=3),
    "three depth images, tilt 0.5 deg, pose 2 mm, 1 deg": ScanErrors(
        depth_views=3, tilt_deg=0.5, pose_mm=2.0, pose_deg=1.0
    ),
}
GRID = [
    ScanErrors(noise_mm=noise, tilt_deg=tilt, pose_mm=mm, pose_deg=deg)
    for noise, tilt, (mm, deg) in product(NOISE, TILT, POSE)
]
ABOUT = (
    "The scenes are known. What is sampled in is a scan of them: surfaces as triangles of 8 mm that scatter, the world "
    "tilted against gravity while the motion is given as if level, the object's pose off by millimetres and degrees; "
    "or three depth images with the noise of a structured-light camera. A configuration counts where it is verified in the "
    "scan **and in the true scene**. It is planned in the scan and executed in the true scene. Of the top-ranked "
    "configuration, in % of all attempted objects; in brackets, 95 % intervals by bootstrap over objects. Written by "
    "`python benchmarks/scan_grid.py`."
)


@dataclass(frozen=True)
class ScanGrid:
    """Run the rows of the page, the grid, or both, and write table, page and chart of what is there."""

    objects: str
    """A set, as in `dexnudge evaluate --objects`."""
    grid_objects: int = 6
    """Objects of the grid, evenly spaced over the set."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    num: int = 32
    """Draws of each trial of the page; half as many in the grid."""
    seed: int = 0
    """Of scenes, draws and errors."""
    workers: int = 2
    """Processes."""
    run: Literal["all", "page", "grid", "none"] = "all"
    """What is run."""
    rows: tuple[str, ...] = tuple(PAGE)
    """Rows of the page that are run."""
    folder: Path = Path("runs/scans")
    """Folder of the runs."""
    root: Path = ROOT
    """Folder that docs/ lies in."""

    def start(self) -> None:
        """Run what is missing; write."""
        config = ExperimentConfig(objects=self.objects, scenes=self.scenes, num=self.num, seed=self.seed)
        if self.run in ("all", "page"):
            for name in self.rows:
                self._run(ScanTrial(PAGE[name]), config, "page")
        if self.run in ("all", "grid"):
            coarse = replace(config, max_objects=self.grid_objects, num=max(1, self.num // 2))
            for errors in GRID:
                self._run(ScanTrial(errors, execute=False), coarse, "grid")
        write_results(self.folder, self.root / "docs")

    def _run(self, kind: ScanTrial, config: ExperimentConfig, part: str) -> None:
        out = self.folder / part / folder_name(kind.errors)
        for _ in TrialRunner([kind], config, out).run(workers=self.workers):
            write_report(kind, out)


def folder_name(errors: ScanErrors) -> str:
    """Return a name for the folder of a run, from the errors that are not 0."""
    named_sizes = [f"{name.replace('_', '')}{size:g}" for name, size in asdict(errors).items() if size]
    return "-".join(named_sizes) or "none"


def write_results(folder: Path, docs: Path) -> None:
    """Write the table, the page and the chart of the runs in a folder; nothing where there is none."""
    page, page_claim = measured_runs(folder / "page", PAGE.values())
    grid, grid_claim = measured_runs(folder / "grid", GRID)
    if not page:
        return
    (docs / "data").mkdir(parents=True, exist_ok=True)
    rows = [
        {"part": part, **asdict(errors), **row}
        for part, measured in (("page", page), ("grid", grid))
        for errors, found in measured.items()
        for row in found
    ]
    (docs / "data" / "scans.csv").write_text(csv_text(rows), encoding="utf-8")
    (first, *_), *_ = page.values()
    attempted = f"{first['objects']} objects of `{Path(page_claim['config']['objects']).name}`, "
    parts = [
        "# Sampling in scans",
        ABOUT,
        attempted + setting(page_claim["config"], page_claim),
        main_table(page).markdown(),
    ]
    parts += ["## What fails", failures_table(page).markdown()]
    if AVAILABLE and (panels := grid_panels(grid)):
        save_chart(grid_chart(panels), docs / "images" / "scans.png")
        parts += ["## Over the grid of errors", setting(grid_claim["config"], grid_claim)]
        parts += ["![Top-ranked true over noise, tilt and pose error](images/scans.png)"]
    parts += ["Every figure: [scans.csv](data/scans.csv)."]
    (docs / "scans.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def measured_runs(
    folder: Path, wanted: Iterable[ScanErrors]
) -> tuple[dict[ScanErrors, list[Measured]], dict[str, Any]]:
    """Return the figures of those runs that are there, by their errors, and what the last one says of its setting."""
    measured: dict[ScanErrors, list[Measured]] = {}
    claim: dict[str, Any] = {}
    for errors in dict.fromkeys(wanted):
        out = folder / folder_name(errors)
        if (out / ScanTrial.folder / FILE).is_file():
            claim, records = read_run(ScanTrial(errors), out)
            measured[errors] = measure(records, ScanTrial.metrics)
    return measured, claim


def main_table(measured: dict[ScanErrors, list[Measured]]) -> Table:
    """Top-ranked true and executed by scene, a row for each of `PAGE`."""
    (top, executed) = named(ScanTrial.metrics, "top_true", "executed")
    scenes = scenes_of(measured)
    rows = []
    for name, errors in PAGE.items():
        if errors in measured:
            found = {row["scene"]: row for row in measured[errors]}
            cells = [
                metric.text(found[scene][metric.name]) if scene in found else ""
                for metric in (top, executed)
                for scene in scenes
            ]
            rows.append([name, *cells])
    return Table(
        ["scan", *(f"true, {scene}" for scene in scenes), *(f"executed, {scene}" for scene in scenes)], rows, labels=1
    )


def failures_table(measured: dict[ScanErrors, list[Measured]]) -> Table:
    """Why the top-ranked configuration is not true or fails in physics, with the number of objects, by scene."""
    scenes, rows = scenes_of(measured), []
    for name, errors in PAGE.items():
        if errors in measured:
            found = {row["scene"]: row for row in measured[errors]}
            rows.append([name, *(counted(found.get(scene)) for scene in scenes)])
    return Table(["scan", *scenes], rows, labels=1 + len(scenes))


def counted(row: Measured | None) -> str:
    """Reasons with their counts; "executed: ..." for those of physics."""
    if row is None:
        return ""
    reasons = [f"{reason} {count}" for reason, count in row["why_not"].items()]
    reasons += [f"executed: {reason} {count}" for reason, count in row["outcomes"].items()]
    return "; ".join(reasons) or "nothing"


def grid_panels(measured: dict[ScanErrors, list[Measured]]) -> dict[tuple[str, str], dict[tuple[float, float], float]]:
    """Top-ranked true by pose error and scene, then by noise and tilt."""
    panels: dict[tuple[str, str], dict[tuple[float, float], float]] = {}
    for errors in GRID:
        for row in measured.get(errors, []):
            panel = panels.setdefault((f"pose {errors.pose_mm:g} mm, {errors.pose_deg:g} deg", row["scene"]), {})
            panel[errors.noise_mm, errors.tilt_deg] = row["top_true"].value
    return panels


def grid_chart(panels: dict[tuple[str, str], dict[tuple[float, float], float]]) -> "Figure":
    """Return a figure of what `grid_panels` returns; cells that are missing stay empty."""
    from matplotlib.figure import Figure

    down, across = (list(dict.fromkeys(name[axis] for name in panels)) for axis in (0, 1))
    figure = Figure(figsize=(WIDTH, 0.8 + WIDTH / len(across) * 0.75 * len(down)), layout="constrained")
    axes = figure.subplots(len(down), len(across), squeeze=False)
    for (row, column), cells in panels.items():
        panel = axes[down.index(row)][across.index(column)]
        low, high = (sorted({size[axis] for size in cells}) for axis in (0, 1))
        shares = np.array([[100.0 * cells.get((one, other), np.nan) for other in high] for one in low])
        panel.imshow(shares, cmap="RdYlGn", vmin=0.0, vmax=100.0, aspect="auto", alpha=0.8)
        for place, share in np.ndenumerate(shares):
            if np.isfinite(share):
                panel.text(place[1], place[0], f"{share:.0f}", ha="center", va="center", fontsize=8, color=INK)
        panel.set_xticks(range(len(high)), [f"{size:g}" for size in high], fontsize=8)
        panel.set_yticks(range(len(low)), [f"{size:g}" for size in low], fontsize=8)
        panel.set_title(f"{column}, {row}", loc="left", fontsize=9)
        panel.set_xlabel("tilt [deg]", fontsize=8)
        panel.set_ylabel("noise [mm]", fontsize=8)
    figure.suptitle("Sampled in scans: top-ranked true [%]", fontsize=11, weight="bold")
    return figure


def scenes_of(measured: dict[ScanErrors, list[Measured]]) -> Sequence[str]:
    """Scenes, in the order in which they were run."""
    return list(dict.fromkeys(row["scene"] for rows in measured.values() for row in rows))


if __name__ == "__main__":
    tyro.cli(ScanGrid).start()
