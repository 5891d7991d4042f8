"""Reads a whole dataset, and verifies its rows again from the objects' meshes."""

from collections.abc import Iterable
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.dataset.schema import BEHAVIOURS, BehaviourCounts
from dexnudge.dataset.shards import Shard, is_complete, read_cloud, read_shard
from dexnudge.errors import DatasetError
from dexnudge.jobs.answers import WorkerDied
from dexnudge.jobs.processes import run_tasks
from dexnudge.jobs.progress import progress
from dexnudge.objects.sets import ObjectEntry, resolve_object_set
from dexnudge.synthesis.finished import totals
from dexnudge.synthesis.object_task import GenerationConfig
from dexnudge.synthesis.row_check import RowCheck, RowCheckTask


@dataclass(frozen=True)
class DatasetCheck:
    """How much was read and verified again, and every difference in words."""

    objects: int
    rows: int
    verified: int
    differences: tuple[str, ...]


def check_dataset(
    folder: Path, *, objects: str | None, num: int | None = None, seed: int = 0, workers: int = 2
) -> DatasetCheck:
    """Read every file and add up its counts; with the set of `objects` it was made from, verify rows again, in parallel.

    Args:
        folder: of the dataset, which may be unfinished.
        objects: the set that it was generated from; None reads only.
        num: verify only so many rows, drawn with `seed` over all objects; None verifies every row.
        seed: of that draw.
        workers: processes.

    Raises:
        DatasetError: a file is damaged or of another dataset; or an object's mesh is not the one it was generated from.
    """
    manifest = read_manifest(folder)
    names = [name for name in sorted(manifest.objects) if is_complete(folder, name)]
    if not names:
        raise DatasetError(f"{folder} holds no shard; expected at least one; run `dexnudge dataset generate` first.")
    rows: dict[str, int] = {}
    counts: dict[str, dict[str, BehaviourCounts]] = {}
    hashes: dict[str, str] = {}
    differences = []
    for name in names:
        shard = read_shard(folder, manifest, name)
        read_cloud(folder, manifest, name)
        rows[name], counts[name], hashes[name] = shard.table.num_rows, shard.counts, shard.mesh_hash
        differences += _count_again(shard, manifest)
    for behaviour, claimed in manifest.counts.items():  # empty until generation has ended
        found = asdict(totals(counts).get(behaviour, BehaviourCounts()))
        if claimed != found:
            differences.append(f"manifest: {claimed} attempts of {behaviour}, {found} in the shards")
    verified = 0
    if objects is not None:
        config = GenerationConfig(**_settings(manifest))
        known = {entry.name: entry for entry in resolve_object_set(objects, units=config.units, length=config.length)}
        tasks = [
            RowCheckTask(_entry(known, name, objects), hashes[name], picked)
            for name, picked in _pick(rows, num, seed).items()
        ]
        check = partial(RowCheck, folder, replace(manifest, objects={}, failed_objects={}), config.hand)
        differences += _verify_again(check, tasks, workers)
        verified = sum(len(task.rows) for task in tasks)
    return DatasetCheck(len(names), sum(rows.values()), verified, tuple(differences))


def _verify_again(check: partial[RowCheck], tasks: list[RowCheckTask], workers: int) -> Iterable[str]:
    found: dict[str, list[str]] = {}
    with progress() as bars, closing(run_tasks(check, tasks, workers=workers)) as results:
        bar = bars.add_task("configurations", total=sum(len(task.rows) for task in tasks))
        for task, result in results:
            name = task.entry.name
            found[name] = [f"{name}: not verified: {result.reason}"] if isinstance(result, WorkerDied) else result
            bars.update(bar, advance=len(task.rows))
    return [difference for name in sorted(found) for difference in found[name]]


def _pick(rows: dict[str, int], num: int | None, seed: int) -> dict[str, Int[np.ndarray, " picked"]]:
    """Which rows of which objects are verified; objects without any are left out."""
    ends = np.cumsum(list(rows.values()))
    total = int(ends[-1])
    chosen = np.arange(total) if num is None else np.sort(np.random.default_rng(seed).permutation(total)[:num])
    picked = {
        name: chosen[(chosen >= end - count) & (chosen < end)] - (end - count)
        for (name, count), end in zip(rows.items(), ends, strict=True)
    }
    return {name: places for name, places in picked.items() if len(places)}


def _count_again(shard: Shard, manifest: Manifest) -> list[str]:
    """Where attempts, rows and the manifest contradict each other."""
    differences = []
    name, labels = shard.object_name, shard.table.column("behaviour").to_pylist()
    for behaviour in BEHAVIOURS:
        count, rows = shard.counts.get(behaviour, BehaviourCounts()), labels.count(behaviour)
        if count.kept != rows:
            differences.append(f"{name}: {count.kept} of {behaviour} counted as kept, {rows} rows in the file")
        if count.attempted != count.kept + count.failed + sum(count.rejected.values()):
            differences.append(f"{name}: the attempts of {behaviour} do not add up: {asdict(count)}")
    if manifest.objects[name] not in (None, shard.mesh_hash):
        differences.append(f"{name}: its shard is of the mesh {shard.mesh_hash}, manifest: {manifest.objects[name]}")
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
