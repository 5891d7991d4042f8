"""Reads a whole dataset, and verifies some of its rows again from the objects' meshes."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from dexnudge.dataset.loading import Dataset, load_dataset
from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.schema import BEHAVIOURS, BehaviourCounts
from dexnudge.dataset.shards import Shard, read_shard
from dexnudge.errors import DatasetError
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.sets import ObjectEntry, resolve_object_set
from dexnudge.synthesis.generate import GenerationConfig, mesh_hash
from dexnudge.synthesis.object_data import at_rest
from dexnudge.synthesis.verification import GraspVerifier, NonPrehensileVerifier, floating_scene, resting_scene

PENETRATION_TOLERANCE = 1e-4  # [m] the same query on another machine; a tenth of what decides
MARGIN_TOLERANCE = 2e-3  # the same solver on another machine; a margin has no unit


@dataclass(frozen=True)
class DatasetCheck:
    """How much was read and verified again, and every difference in words."""

    objects: int
    rows: int
    verified: int
    differences: tuple[str, ...]


def check_dataset(folder: Path, *, objects: str | None, num: int, seed: int) -> DatasetCheck:
    """Read every shard and add up its counts; with the set of `objects` it was made from, verify `num` rows again.

    Raises:
        DatasetError: a shard is missing, damaged, or of another dataset; or an object's mesh is not the one it was
            generated from.
    """
    dataset = load_dataset(folder, allow_incomplete=True)
    differences = _count_again(folder, dataset)
    if objects is None:
        return DatasetCheck(len(dataset.object_names), len(dataset), 0, tuple(differences))
    config = GenerationConfig(**_settings(dataset.manifest))
    hand = load_hand(config.hand)
    known = {entry.name: entry for entry in resolve_object_set(objects, units=config.units, length=config.length)}
    picked = np.random.default_rng(seed).permutation(len(dataset))[:num]
    for index in np.unique(dataset.object_index[picked]):
        name = dataset.object_names[index]
        first = int(np.searchsorted(dataset.object_index, index))
        rows = np.sort(picked[dataset.object_index[picked] == index]) - first
        shard = read_shard(folder, dataset.manifest, name)
        differences += _verify_again(hand, _entry(known, name, objects), dataset.manifest, shard, rows)
    return DatasetCheck(len(dataset.object_names), len(dataset), len(picked), tuple(differences))


def _count_again(folder: Path, dataset: Dataset) -> list[str]:
    """Where attempts, rows and totals contradict each other."""
    differences = []
    totals: dict[str, BehaviourCounts] = {}
    for index, name in enumerate(dataset.object_names):
        labels = dataset.behaviour[dataset.object_index == index]
        counts = read_shard(folder, dataset.manifest, name).counts
        for place, behaviour in enumerate(BEHAVIOURS):
            count, rows = counts.get(behaviour, BehaviourCounts()), int((labels == place).sum())
            if count.kept != rows:
                differences.append(f"{name}: {count.kept} of {behaviour} counted as kept, {rows} rows in the file")
            if count.attempted != count.kept + count.failed + sum(count.rejected.values()):
                differences.append(f"{name}: the attempts of {behaviour} do not add up: {asdict(count)}")
            totals[behaviour] = totals.get(behaviour, BehaviourCounts()) + count
    for behaviour, claimed in dataset.manifest.counts.items():  # empty until generation has ended
        found = asdict(totals.get(behaviour, BehaviourCounts()))
        if claimed != found:
            differences.append(f"manifest: {claimed} attempts of {behaviour}, {found} in the shards")
    return differences


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
    mesh = at_rest(mesh)
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
            differences += _numbers(
                label, "direction_margin", margins[row], found.direction_margin[place], MARGIN_TOLERANCE
            )
    return differences


def _numbers(
    label: str,
    what: str,
    stored: list[float] | Float[np.ndarray, " n"],
    found: Float[np.ndarray, " n"],
    tolerance: float,
) -> list[str]:
    error = np.abs(np.asarray(stored) - found)
    if (error <= tolerance).all():
        return []
    worst = int(np.argmax(error))
    return [f"{label}: {what}[{worst}] is {np.asarray(stored)[worst]:.5f} in the file, {found[worst]:.5f} found"]
