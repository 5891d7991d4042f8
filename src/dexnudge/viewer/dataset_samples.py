"""Random rows of a dataset as pictures: the hand, the object, where they touch, and the motion that suits the row best."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import UInt8

from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.dataset.schema import BEHAVIOURS, best_direction, direction_angles
from dexnudge.dataset.shards import is_complete, read_shard
from dexnudge.errors import DatasetError
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.builtin import builtin_object, is_builtin
from dexnudge.objects.named import scaled_to_length
from dexnudge.objects.sets import ObjectEntry, resolve_object_set
from dexnudge.synthesis.object_data import at_rest
from dexnudge.synthesis.object_task import mesh_hash
from dexnudge.synthesis.verification import resting_scene
from dexnudge.viewer.drawing import Drawing, drawing
from dexnudge.viewer.picture import render_array

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


def row_drawing(hand: Hand, mesh: trimesh.Trimesh, values: dict) -> Drawing:
    """The drawing of one row, on the plane and with the arrow of its best direction; of a grasp without both.

    The base behind the palm is left out: it is large, touches nothing, and would hide the hand.
    """
    scene = resting_scene(mesh)
    grasp = values["behaviour"] == "grasp"
    angle = _best_angle(values)
    contacts = np.asarray(values["contact_points"], dtype=np.float64).reshape(-1, 3)
    shown = drawing(scene, hand, np.asarray(values["q"], dtype=np.float64), contacts=contacts)
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
