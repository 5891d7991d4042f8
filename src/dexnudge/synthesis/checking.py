"""Reads a whole dataset, and verifies some of its rows again from the objects' meshes."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.shards import Shard, read_shard
from dexnudge.errors import DatasetError
from dexnudge.geometry.frames import resting_origin
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.sets import ObjectEntry, resolve_object_set
from dexnudge.scenes.resting import resting_pose
from dexnudge.synthesis.generate import GenerationConfig, mesh_hash
from dexnudge.synthesis.verification import GraspVerifier, NonPrehensileVerifier, floating_scene, resting_scene

PENETRATION_TOLERANCE = 2e-4  # [m] what independent distance queries on the same mesh may differ by
MARGIN_TOLERANCE = 0.02  # relative; what independent solvers of the force balance may differ by


@dataclass(frozen=True)
class DatasetCheck:
    """How much was read and verified again, and every difference in words."""

    objects: int
    rows: int
    verified: int
    differences: tuple[str, ...]


def check_dataset(folder: Path, *, objects: str | None, num: int, seed: int) -> DatasetCheck:
    """Read every shard; with the set of `objects` that it was made from, verify `num` rows again.

    Raises:
        DatasetError: a shard is missing, damaged, or of another dataset; or an object's mesh is not the one it was
            generated from.
    """
    dataset = load_dataset(folder, allow_incomplete=True)
    if objects is None:
        return DatasetCheck(len(dataset.object_names), len(dataset), 0, ())
    config = GenerationConfig(**_settings(dataset.manifest))
    hand = load_hand(config.hand)
    known = {entry.name: entry for entry in resolve_object_set(objects, units=config.units, length=config.length)}
    picked = np.random.default_rng(seed).permutation(len(dataset))[:num]
    differences: list[str] = []
    for index in np.unique(dataset.object_index[picked]):
        name = dataset.object_names[index]
        first = int(np.searchsorted(dataset.object_index, index))
        rows = np.sort(picked[dataset.object_index[picked] == index]) - first
        shard = read_shard(folder, dataset.manifest, name)
        differences += _verify_again(hand, _entry(known, name, objects), dataset.manifest, shard, rows)
    return DatasetCheck(len(dataset.object_names), len(dataset), len(picked), tuple(differences))


def _settings(manifest: Manifest) -> dict[str, Any]:
    """The settings that `GenerationConfig` knows; DatasetError when the manifest lacks some."""
    names = [field.name for field in fields(GenerationConfig)]
    missing = [name for name in names if name not in manifest.config]
    if missing:
        raise DatasetError(
            f"the manifest lacks the setting {missing[0]!r}; expected {', '.join(names)}; generate again"
        )
    return {name: manifest.config[name] for name in names}


def _entry(known: dict[str, ObjectEntry], name: str, objects: str) -> ObjectEntry:
    if name not in known:
        raise DatasetError(
            f"the dataset has the object {name!r}, which is not in {objects}; expected the set that it was generated "
            "from; mend --objects"
        )
    return known[name]


def _verify_again(hand: Hand, entry: ObjectEntry, manifest: Manifest, shard: Shard, rows: np.ndarray) -> list[str]:
    mesh = entry.load()
    if mesh_hash(mesh) != manifest.objects[entry.name]:
        raise DatasetError(
            f"the mesh of {entry.name!r} is not the one that the dataset was generated from; mend --objects"
        )
    mesh.apply_transform(resting_pose(mesh))
    mesh.apply_translation(-resting_origin(mesh))
    table = shard.table.take(pa.array(rows))
    q = shard.column_matrix("q")[rows].astype(np.float64)
    margins = shard.column_matrix("direction_margin")[rows]
    grasps = np.array([behaviour == "grasp" for behaviour in table.column("behaviour").to_pylist()], dtype=bool)
    differences = []
    for chosen, verify in (
        (np.flatnonzero(~grasps), lambda: NonPrehensileVerifier(hand, resting_scene(mesh))),
        (np.flatnonzero(grasps), lambda: GraspVerifier(hand, floating_scene(mesh))),
    ):
        if not len(chosen):
            continue
        found = verify()(q[chosen])
        for place, row in enumerate(chosen):
            label = f"{entry.name}, row {rows[row]}"
            if found.reason[place]:
                differences.append(f"{label}: kept in the file, found to be rejected for {found.reason[place]}")
                continue
            stored = [table.column(f"penetration_{what}")[row].as_py() for what in ("object", "environment", "self")]
            differences += _numbers(label, "penetration", stored, found.penetration[place], PENETRATION_TOLERANCE)
            tolerance = MARGIN_TOLERANCE * np.maximum(1.0, np.abs(found.direction_margin[place]))
            differences += _numbers(label, "direction_margin", margins[row], found.direction_margin[place], tolerance)
    return differences


def _numbers(
    label: str,
    what: str,
    stored: list[float] | Float[np.ndarray, " n"],
    found: Float[np.ndarray, " n"],
    tolerance: float | Float[np.ndarray, " n"],
) -> list[str]:
    error = np.abs(np.asarray(stored) - found)
    if (error <= tolerance).all():
        return []
    worst = int(np.argmax(error))
    return [f"{label}: {what}[{worst}] is {np.asarray(stored)[worst]:.5f} in the file, {found[worst]:.5f} found"]
