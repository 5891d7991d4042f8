"""One HTML file about a dataset: pictures of random rows, charts and tables; no server, no internet, no script."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import UInt8

from dexnudge.dataset.document import Table
from dexnudge.dataset.info import DatasetInfo
from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.dataset.page import chart_html, document_page, picture_html, pictures_html
from dexnudge.dataset.schema import BEHAVIOURS, best_direction, direction_angles
from dexnudge.dataset.shards import complete_objects, read_shard
from dexnudge.hands.hand import Hand
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.synthesis.acceptance import resting_scene
from dexnudge.synthesis.dataset_card import description
from dexnudge.synthesis.object_data import ObjectMeshes
from dexnudge.viewer.picture import arrange, render_array, write_png
from dexnudge.viewer.visual_scene import VisualScene, visual_scenes

SAMPLES = 5  # of each behaviour: a row of pictures
TILE = (560, 480)  # pixels of one picture


@dataclass(frozen=True, eq=False)
class RowPicture:
    """One row of a dataset: its behaviour, a caption, and its picture."""

    behaviour: str
    caption: tuple[str, ...]
    picture: UInt8[np.ndarray, "height width 3"]


def draw_samples(folder: Path | str, *, objects: str | None = None, seed: int = 0) -> list[RowPicture]:
    """Draw up to five random rows of each behaviour, in the order of `BEHAVIOURS`; `seed` decides which.

    objects: the set that the dataset was generated from; not needed where all objects are built-in ones.

    Raises:
        DatasetError: the dataset is damaged, or an object's mesh is not the one that it was generated from.
        HandError: the hand that the manifest names cannot be loaded.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    hand = manifest.load_hand(folder)
    meshes = ObjectMeshes(manifest, objects)
    samples = []
    for name, row in pick_rows(folder, manifest, np.random.default_rng(seed)):
        values = read_shard(folder, manifest, name).table.slice(row, 1).to_pylist()[0]
        shown = row_drawing(hand, meshes.at_rest(name, manifest.objects[name]), values)
        samples.append(RowPicture(values["behaviour"], row_caption(values), render_array(shown, size=TILE)))
    return samples


def pick_rows(folder: Path, manifest: Manifest, generator: np.random.Generator) -> list[tuple[str, int]]:
    """Return (object, row in its shard) of up to five rows of each behaviour; all rows of a behaviour are equally likely."""
    places: dict[str, list[tuple[str, int]]] = {behaviour: [] for behaviour in BEHAVIOURS}
    for name in complete_objects(folder, manifest):
        labels = read_shard(folder, manifest, name).table.column("behaviour").to_pylist()
        for row, behaviour in enumerate(labels):
            places[behaviour].append((name, row))
    return [
        rows[index]
        for rows in places.values()
        for index in np.sort(generator.permutation(len(rows))[:SAMPLES]).tolist()
    ]


def row_drawing(hand: Hand, mesh: trimesh.Trimesh, values: dict) -> VisualScene:
    """Return the drawing of one row, on the plane and with the arrow of its best direction; of a grasp without both.

    The base behind the palm is left out: it is large, touches nothing, and would hide the hand.
    """
    scene = resting_scene(mesh)
    grasp = values["behaviour"] == "grasp"
    angle = _best_angle(values)
    contacts = np.asarray(values["contact_points"], dtype=np.float64).reshape(-1, 3)
    shown = visual_scenes(scene, hand, np.asarray(values["q"], dtype=np.float64)[None], contacts=[contacts])[0]
    hidden = ("base", "environment") if grasp else ("base",)
    return replace(
        shown,
        parts=tuple(part for part in shown.parts if part.role not in hidden),
        motion=np.zeros(3) if grasp else np.array([np.cos(angle), np.sin(angle), 0.0]),
    )


def _best_angle(values: dict) -> float:
    """Angle [rad] of the direction that decided the row's behaviour."""
    return float(direction_angles()[best_direction(np.asarray(values["direction_margin"]))])


def row_caption(values: dict) -> tuple[str, ...]:
    """Return lines: the object and its digits; the greatest margin and its direction, or the drift of a held grasp."""
    digits = "+".join(values["digits"])
    if values["behaviour"] != "grasp":
        margin, angle = max(values["direction_margin"]), np.degrees(_best_angle(values))
        return (f"{values['object']}, {digits}", f"margin {margin:.2f} along {angle:g}°")
    if values["hold_translation"] is None:
        return (f"{values['object']}, {digits}", "grasp")
    turned = np.degrees(values["hold_rotation"])
    return (
        f"{values['object']}, {digits}",
        f"drift {1e3 * values['hold_translation']:.1f} mm, {turned:.1f}° when held",
    )


PAGE_FILE = "dataset.html"
CAPTION_ROOM = 0.22  # of a picture's height: white above it on a sheet, for two lines of text
COLOURS = {"grasp": "#3b6fb6", "push": "#e07b39", "press": "#2a8f6a", "hook": "#8e5ea2"}
OTHER_COLOUR = "#66707d"
CHART_SIZE = (4.8, 2.4)  # inches
MOST_UPRIGHT = 8  # labels that fit side by side; more are turned
SHOWN = (
    "Yellow: where the hand touches the object. Green: the best direction of motion. "
    "The base behind the palm is not drawn."
)
NO_CHARTS = "Without charts: they are drawn by matplotlib, which is not installed; pip install dexnudge[plots]."


def write_dataset_page(info: DatasetInfo, samples: list[RowPicture], folder: Path | str) -> list[Path]:
    """Write `dataset.html`, and for each behaviour with samples a sheet `samples-<behaviour>.png`; return all paths.

    Raises:
        OutputError: the folder cannot be written.
    """
    folder = Path(folder)
    document = description(info)
    drawn = charts(document.tables) if find_spec("matplotlib") else f"<p>{NO_CHARTS}</p>"
    rows = "\n".join(_section(behaviour, samples) for behaviour in BEHAVIOURS)
    page = document_page(document, f'<p>{SHOWN}</p>\n{rows}\n<h2>Charts</h2>\n<div class="charts">\n{drawn}\n</div>')
    with replace_atomically(folder / PAGE_FILE) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")
    written = [folder / PAGE_FILE]
    for behaviour in BEHAVIOURS:
        shown = [sample for sample in samples if sample.behaviour == behaviour]
        if shown:
            written.append(write_png(_sheet(shown), folder / f"samples-{behaviour}.png"))
    return written


def _sheet(samples: list[RowPicture]) -> UInt8[np.ndarray, "height width 3"]:
    room = round(CAPTION_ROOM * samples[0].picture.shape[0])
    pictures = [np.pad(sample.picture, ((room, 0), (0, 0), (0, 0)), constant_values=255) for sample in samples]
    return arrange(pictures, ["\n".join(sample.caption) for sample in samples], columns=len(samples))


def _section(behaviour: str, samples: list[RowPicture]) -> str:
    shown = [sample for sample in samples if sample.behaviour == behaviour]
    if not shown:
        return f"<h2>{escape(behaviour)}</h2>\n<p>no rows</p>"
    pictures = [picture_html(sample.picture, sample.caption, about=behaviour) for sample in shown]
    return pictures_html(f"{behaviour}: random samples", pictures)


def charts(tables: list[Table]) -> str:
    """Return the charts of those tables that can be drawn, as images; needs matplotlib."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    images = []
    with mpl.rc_context({"font.size": 8.0}):
        for table in tables:
            if not table.chart or not table.rows:
                continue
            figure = Figure(figsize=CHART_SIZE, layout="constrained")
            axes = figure.add_subplot()
            labels = table.header[1:] if table.chart == "bars" else [str(row[0]) for row in table.rows]
            if table.chart == "bars":
                _stack(axes, table, labels)
            else:
                _ranges(axes, table, labels)
            axes.set_title(table.title)
            axes.spines[["top", "right"]].set_visible(False)
            images.append(chart_html(figure, table.title))
    return "\n".join(images)


def _stack(axes: Any, table: Table, labels: Sequence[str]) -> None:
    """Bars of the behaviours on top of each other; of a table by something else, its first row."""
    rows = [row for row in table.rows if row[0] in BEHAVIOURS] or table.rows[:1]
    reached = np.zeros(len(labels))
    for name, *counts in rows:
        axes.bar(range(len(labels)), counts, bottom=reached, label=name, color=COLOURS.get(str(name), OTHER_COLOUR))
        reached += np.asarray(counts, dtype=np.float64)
    axes.set_xticks(range(len(labels)), labels, rotation=90 if len(labels) > MOST_UPRIGHT else 0)
    axes.figure.legend(loc="outside right upper", frameon=False)


def _ranges(axes: Any, table: Table, labels: Sequence[str]) -> None:
    """A bar from the least to the greatest of the last three cells of each row, and a mark at the one between."""
    least, median, greatest = np.asarray([row[-3:] for row in table.rows], dtype=np.float64).T
    axes.barh(labels, greatest - least, left=least, color=COLOURS["grasp"])
    axes.scatter(median, labels, color="black", marker="|", zorder=3)
    axes.set_xlabel("% of range")
    axes.invert_yaxis()
