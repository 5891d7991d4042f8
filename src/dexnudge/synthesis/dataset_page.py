"""One HTML file about a dataset: pictures of random rows, charts and tables; no server, no internet, no script."""

import base64
import io
from dataclasses import dataclass, replace
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np
import trimesh
from jaxtyping import UInt8
from PIL import Image

from dexnudge.dataset.info import DatasetInfo
from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.dataset.schema import BEHAVIOURS, best_direction, direction_angles
from dexnudge.dataset.shards import is_complete, read_shard
from dexnudge.dataset.tables import Table, coverage_tables, summary, tables
from dexnudge.errors import DatasetError
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.folders import replace_atomically
from dexnudge.objects.builtin import builtin_object, is_builtin
from dexnudge.objects.sets import ObjectEntry, resolve_object_set, scaled_to_length
from dexnudge.synthesis.object_data import at_rest
from dexnudge.synthesis.object_task import mesh_hash
from dexnudge.synthesis.verification import resting_scene
from dexnudge.viewer.bar_chart import bar_chart, range_chart
from dexnudge.viewer.picture import arrange, render_array, write_png
from dexnudge.viewer.visual_scene import VisualScene, visual_scene

SAMPLES = 5  # of each behaviour: a row of pictures
TILE = (560, 480)  # pixels of one picture


@dataclass(frozen=True, eq=False)
class Sample:
    """One row, what is to be said of it, and its picture."""

    behaviour: str
    caption: tuple[str, ...]
    picture: UInt8[np.ndarray, "height width 3"]


def draw_samples(folder: Path | str, *, objects: str | None = None, seed: int = 0) -> list[Sample]:
    """Draw up to five random rows of each behaviour, in the order of `BEHAVIOURS`.

    Args:
        folder: of the dataset.
        objects: the set that it was generated from; not needed where all objects are built-in ones.
        seed: which rows.

    Raises:
        DatasetError: the dataset is damaged, or an object's mesh is not the one that it was generated from.
        HandError: the hand that the manifest names cannot be loaded.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    hand = load_hand(str(manifest.config.get("hand", manifest.hand)))
    meshes = ObjectMeshes(manifest, objects)
    samples = []
    for name, row in pick_rows(folder, manifest, np.random.default_rng(seed)):
        values = read_shard(folder, manifest, name).table.slice(row, 1).to_pylist()[0]
        shown = row_drawing(hand, meshes.at_rest(name), values)
        samples.append(Sample(values["behaviour"], row_caption(values), render_array(shown, size=TILE)))
    return samples


def pick_rows(folder: Path, manifest: Manifest, generator: np.random.Generator) -> list[tuple[str, int]]:
    """(object, row in its shard) of up to five rows of each behaviour; all rows of a behaviour are equally likely."""
    places: dict[str, list[tuple[str, int]]] = {behaviour: [] for behaviour in BEHAVIOURS}
    for name in (name for name in sorted(manifest.objects) if is_complete(folder, name)):
        labels = read_shard(folder, manifest, name).table.column("behaviour").to_pylist()
        for row, behaviour in enumerate(labels):
            places[behaviour].append((name, row))
    return [
        rows[index]
        for rows in places.values()
        for index in np.sort(generator.permutation(len(rows))[:SAMPLES]).tolist()
    ]


class ObjectMeshes:
    """The meshes of a dataset's objects in their resting frames, checked against the manifest's hashes."""

    def __init__(self, manifest: Manifest, objects: str | None) -> None:
        self._manifest = manifest
        self._objects = objects
        length = manifest.config.get("length")
        self._length = float(length) if isinstance(length, int | float) else None
        self._known: dict[str, ObjectEntry] = {}
        if objects is not None:
            units = str(manifest.config.get("units", "m"))
            self._known = {entry.name: entry for entry in resolve_object_set(objects, units=units, length=self._length)}

    def at_rest(self, name: str) -> trimesh.Trimesh:
        """The mesh of one object [m], resting frame; raises DatasetError when it is not to be had, or another one."""
        if name in self._known:
            mesh = self._known[name].load()
        elif self._objects is None and is_builtin(name):
            mesh = scaled_to_length(builtin_object(name), self._length)
        else:
            raise DatasetError(
                f"the mesh of {name!r} is not in {self._objects or 'the built-in objects'}; expected the set that the "
                "dataset was generated from; give it with --objects"
            )
        if mesh_hash(mesh) != self._manifest.objects[name]:
            raise DatasetError(
                f"the mesh of {name!r} is not the one that the dataset was generated from; mend --objects"
            )
        return at_rest(mesh)


def row_drawing(hand: Hand, mesh: trimesh.Trimesh, values: dict) -> VisualScene:
    """The drawing of one row, on the plane and with the arrow of its best direction; of a grasp without both.

    The base behind the palm is left out: it is large, touches nothing, and would hide the hand.
    """
    scene = resting_scene(mesh)
    grasp = values["behaviour"] == "grasp"
    angle = _best_angle(values)
    contacts = np.asarray(values["contact_points"], dtype=np.float64).reshape(-1, 3)
    shown = visual_scene(scene, hand, np.asarray(values["q"], dtype=np.float64), contacts=contacts)
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
    """Lines: the object; its digits; the greatest margin and its direction, or how far a held grasp let it drift."""
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


def write_dataset_page(info: DatasetInfo, samples: list[Sample], folder: Path | str) -> list[Path]:
    """Write `dataset.html`, and for each behaviour that has samples a sheet `samples-<behaviour>.png`.

    Returns:
        The page's path, then the sheets'.

    Raises:
        OutputError: the folder cannot be written.
    """
    folder = Path(folder)
    package = files("dexnudge.viewer")
    page = Template((package / "dataset_page.html").read_text(encoding="utf-8")).substitute(
        title=escape(f"Dataset of the hand {info.manifest.hand}"),
        summary=escape(summary(info)),
        samples="\n".join(_section(behaviour, samples) for behaviour in BEHAVIOURS),
        charts="\n".join(_charts(info)),
        tables="\n".join(_table(table) for table in tables(info)),
    )
    with replace_atomically(folder / PAGE_FILE) as temporary:
        temporary.write_text(page, encoding="utf-8")
    written = [folder / PAGE_FILE]
    for behaviour in BEHAVIOURS:
        shown = [sample for sample in samples if sample.behaviour == behaviour]
        if shown:
            written.append(write_png(_sheet(shown), folder / f"samples-{behaviour}.png"))
    return written


def _sheet(samples: list[Sample]) -> UInt8[np.ndarray, "height width 3"]:
    room = round(CAPTION_ROOM * samples[0].picture.shape[0])
    pictures = [np.pad(sample.picture, ((room, 0), (0, 0), (0, 0)), constant_values=255) for sample in samples]
    return arrange(pictures, ["\n".join(sample.caption) for sample in samples], columns=len(samples))


def _section(behaviour: str, samples: list[Sample]) -> str:
    shown = [sample for sample in samples if sample.behaviour == behaviour]
    if not shown:
        return f"<h2>{escape(behaviour)}</h2>\n<p>no rows</p>"
    figures = "\n".join(
        f'<figure><img alt="{escape(behaviour)}: {escape(", ".join(sample.caption))}" src="{_data_url(sample.picture)}">'
        f"<figcaption>{'<br>'.join(map(escape, sample.caption))}</figcaption></figure>"
        for sample in shown
    )
    return f'<h2>{escape(behaviour)}: random samples</h2>\n<div class="samples">\n{figures}\n</div>'


def _charts(info: DatasetInfo) -> list[str]:
    """The histograms, what of the coverage is counted by behaviour, the directions, and the joints' ranges."""
    charts = [
        bar_chart(
            histogram.title,
            [f"{edge:.4g}" for edge in histogram.edges[:-1]],
            {label: counts.tolist() for label, counts in histogram.counts.items()},
        )
        for histogram in info.histograms
    ]
    for table in coverage_tables(info):
        rows = {row[0]: [int(cell) for cell in row[1:]] for row in table.rows}
        counted = {label: counts for label, counts in rows.items() if label in (*BEHAVIOURS, "rows")}
        charts.append(bar_chart(table.title, table.header[1:], counted))
    if info.joint_limits is not None and info.num_configurations:
        lower, upper = info.joint_limits[:, :1], info.joint_limits[:, 1:]
        shares = np.clip((info.joint_angles - lower) / (upper - lower), 0.0, 1.0)
        ranges = [(float(low), float(middle), float(high)) for low, middle, high in shares]
        charts.append(range_chart("joint angles within their limits", info.manifest.joint_names, ranges))
    return charts


def _table(table: Table) -> str:
    header = "".join(f"<th>{escape(cell)}</th>" for cell in (table.title, *table.header[1:]))
    rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>\n" for row in table.rows)
    return f'<div class="scroll"><table><thead><tr>{header}</tr></thead>\n<tbody>\n{rows}</tbody></table></div>'


def _data_url(picture: UInt8[np.ndarray, "height width 3"]) -> str:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG", optimize=False)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")
