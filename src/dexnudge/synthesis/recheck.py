"""Reads a whole dataset, verifies its rows again from the objects' meshes, and judges how they turn, where that is new."""

from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dexnudge.dataset.info import known_hand
from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.dataset.schema import INFEASIBLE, TURNS, BehaviourCounts
from dexnudge.dataset.shards import (
    DamagedShardError,
    Shard,
    column_matrix,
    complete_objects,
    read_shard,
    read_whole,
    write_turns,
)
from dexnudge.errors import DatasetError
from dexnudge.jobs.processes import WorkerDied, run_tasks
from dexnudge.jobs.progress import progress
from dexnudge.simulation.hold import FARTHEST, MOST_TURNED
from dexnudge.synthesis.acceptance import (
    GraspVerifier,
    NonPrehensileVerifier,
    Verified,
    floating_scene,
    resting_scene,
)
from dexnudge.synthesis.generate import totals
from dexnudge.synthesis.object_data import ObjectMeshes
from dexnudge.verification.criteria import SUCCESS_MARGIN

PENETRATION_TOLERANCE = 1e-4  # [m] the same query on another machine; a tenth of what decides
MARGIN_TOLERANCE = 2e-3  # the same solver on another machine, and the rounding of what is stored; no unit
TWIST_TOLERANCE = 1e-5  # [m/m, rad/m] the same geometry on another machine
CONTACT_TOLERANCE = 1e-4  # [m] thirteen times the rounding of what is stored, a twentieth of what counts as contact
# That a grasp holds must come out again. How far the object drifts is the same number on the same machine; on another
# one sums end in other last digits, and contacts that slip amplify them: changes of 1e-12 to 1e-6 in q and contacts moved
# drifts by up to 0.15 mm and 0.003 rad. This share of what decides is 2.5 mm and 0.013 rad.
DRIFT_SHARE = 0.05
TOLERANCES = {
    **dict.fromkeys(("penetration_object", "penetration_environment", "penetration_self"), PENETRATION_TOLERANCE),
    "direction_margin": MARGIN_TOLERANCE,
    "turn_margin": MARGIN_TOLERANCE,
    "contact_points": CONTACT_TOLERANCE,
    "hold_translation": DRIFT_SHARE * FARTHEST,
    "hold_rotation": DRIFT_SHARE * MOST_TURNED,
}
BATCH = 256  # rows verified together: what memory a worker needs does not grow with the shard


class _OfObjects:
    """What is done with the rows of one object after another, with the hand loaded once."""

    def __init__(self, folder: Path, manifest: Manifest, meshes: ObjectMeshes) -> None:
        self._folder, self._manifest, self._meshes = folder, manifest, meshes
        self._hand = manifest.load_hand(folder)


class RowCheck(_OfObjects):
    """Verifies the rows of an object."""

    def __call__(self, task: tuple[str, Int[np.ndarray, " picked"]]) -> list[str]:
        """Return every difference between an object's rows in the shard and what is found now, in words.

        Raises:
            DatasetError: the mesh is another one; the shard is damaged.
        """
        name, rows = task
        shard = read_shard(self._folder, self._manifest, name)
        mesh = self._meshes.at_rest(name, shard.mesh_hash)
        is_grasp = np.array([label == "grasp" for label in shard.table.column("behaviour").to_pylist()], dtype=bool)
        grasps, others = rows[is_grasp[rows]], rows[~is_grasp[rows]]
        differences = []
        if len(others):
            verifier = NonPrehensileVerifier(self._hand, resting_scene(mesh))
            differences += _compare(shard, others, verifier)
            if shard.turns is not None:
                differences += _numbers(f"{name}: turns", shard.turns, verifier.turns, TWIST_TOLERANCE)
        if len(grasps):
            differences += _compare(shard, grasps, GraspVerifier(self._hand, floating_scene(mesh)))
        return differences


def _compare(
    shard: Shard, rows: Int[np.ndarray, " picked"], verify: Callable[[Float[np.ndarray, "n coordinates"]], Verified]
) -> list[str]:
    q = column_matrix(shard.table, "q").astype(np.float64)
    differences = []
    for start in range(0, len(rows), BATCH):
        batch = rows[start : start + BATCH]
        found = verify(q[batch])
        for place, (row, stored) in enumerate(zip(batch, shard.table.take(batch).to_pylist(), strict=True)):
            label = f"{shard.object_name}, row {row}"
            if found.reason[place]:
                differences.append(f"{label}: kept in the file, found to be rejected for {found.reason[place]}")
            else:
                lies = _row_differences(stored, found.columns(place))
                differences += [f"{label}: {lie}" for lie in lies]
    return differences


def _row_differences(stored: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Where the columns of one row differ from those found now."""
    differences = [
        f"{name} are {tuple(stored[name])} in the file, {found[name]} found"
        for name in ("contact_links", "digits")
        if tuple(stored[name]) != found[name]
    ]
    for name, tolerance in TOLERANCES.items():
        if name not in stored:  # of LATER_COLUMNS, in a dataset from before
            continue
        ours, theirs = len(np.atleast_1d(found[name])), len(np.atleast_1d(stored[name]))
        if ours == theirs:
            differences += _numbers(name, stored[name], found[name], tolerance)
        elif tuple(stored["contact_links"]) == found["contact_links"]:
            differences.append(f"{theirs} {name} in the file, {ours} found")
    return differences


def _numbers(what: str, stored: Any, found: Float[np.ndarray, "*shape"] | float | None, tolerance: float) -> list[str]:
    """The worst difference of a column's numbers, if any; nothing stored (None) equals nothing found (NaN)."""
    ours, theirs = np.asarray(found, dtype=np.float64), np.asarray(stored, dtype=np.float64)
    error = np.where(np.isnan(theirs) & np.isnan(ours), 0.0, np.abs(theirs - ours))
    if (error <= tolerance).all():
        return []
    worst = np.unravel_index(np.argmax(error), error.shape)  # a NaN is the worst
    place = "".join(f"[{index}]" for index in worst)
    return [f"{what}{place} is {theirs[worst]:.5f} in the file, {ours[worst]:.5f} found"]


class TurnLabels(_OfObjects):
    """Judges how the rows of an object can turn it, and writes that into their shard."""

    def __call__(self, name: str) -> int:
        """Return how many rows can turn or tip the object.

        Raises:
            DatasetError: the mesh is another one; the shard is damaged.
            OutputError: the shard cannot be written; it is as it was.
        """
        shard = read_shard(self._folder, self._manifest, name)
        verifier = NonPrehensileVerifier(self._hand, resting_scene(self._meshes.at_rest(name, shard.mesh_hash)))
        others = np.flatnonzero([label != "grasp" for label in shard.table.column("behaviour").to_pylist()])
        q = column_matrix(shard.table, "q").astype(np.float64)
        margin = np.full((len(q), len(TURNS)), INFEASIBLE)
        for start in range(0, len(others), BATCH):
            batch = others[start : start + BATCH]
            margin[batch] = verifier(q[batch]).turn_margin
        write_turns(self._folder, self._manifest, shard, margin, verifier.turns)
        return int((margin.max(axis=1) >= SUCCESS_MARGIN).sum())


def label_turns(folder: Path, *, objects: str | None, workers: int = 2) -> int:
    """Judge the turns of a dataset from before they were; return how many shards were written, those without any.

    objects: the set that the dataset was generated from. A stopped run goes on where it was.

    Raises:
        DatasetError: an object's mesh is not the one it was generated from.
    """
    manifest = read_manifest(folder)
    meshes = ObjectMeshes(manifest, objects)
    names = [name for name in complete_objects(folder, manifest) if read_shard(folder, manifest, name).turns is None]
    for name in names:
        meshes.check_known(name)
    label = partial(TurnLabels, folder, replace(manifest, objects={}, failed_objects={}), meshes)
    with progress() as bars, closing(run_tasks(label, names, workers=workers)) as results:
        bar = bars.add_task("objects", total=len(names))
        for name, result in results:
            if isinstance(result, WorkerDied):
                raise DatasetError(f"{name} could not be judged: {result.reason}; the same command goes on")
            bars.update(bar, advance=1)
    return len(names)


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

    Reading refuses numbers that are not finite and behaviours, digits and links (where the hand can be loaded) that do
    not exist. The dataset may be unfinished. num: verify only so many rows, drawn with `seed` over all objects.

    Raises:
        DatasetError: a file is of another dataset; or an object's mesh is not the one it was generated from.
    """
    manifest = read_manifest(folder)
    names = complete_objects(folder, manifest)
    if not names:
        raise DatasetError(f"{folder} holds no shard; expected at least one; run `dexnudge dataset generate` first.")
    hand = known_hand(manifest, folder)
    shards: dict[str, Shard] = {}
    differences = []
    for name, shard in read_whole(folder, manifest, names, links=hand.link_names if hand else None):
        if isinstance(shard, DamagedShardError):
            differences.append(str(shard))
        else:
            shards[name] = shard
            if manifest.objects[name] not in (None, shard.mesh_hash):
                own = manifest.objects[name]
                differences.append(f"{name}: its shard is of the mesh {shard.mesh_hash}, manifest: {own}")
    counts = totals({name: shard.counts for name, shard in shards.items()})
    for behaviour, claimed in manifest.counts.items():  # empty until generation has ended
        found = asdict(counts.get(behaviour, BehaviourCounts()))
        if claimed != found and len(shards) == len(names):
            differences.append(f"manifest: {claimed} attempts of {behaviour}, {found} in the shards")
    verified = 0
    if objects is not None:
        meshes = ObjectMeshes(manifest, objects)
        picked = _pick({name: shard.table.num_rows for name, shard in shards.items()}, num, seed)
        for name in picked:
            meshes.check_known(name)
        check = partial(RowCheck, folder, replace(manifest, objects={}, failed_objects={}), meshes)
        differences += _verify_again(check, list(picked.items()), workers)
        verified = sum(map(len, picked.values()))
    num_rows = sum(shard.table.num_rows for shard in shards.values())
    return DatasetCheck(len(names), num_rows, verified, tuple(differences))


def _verify_again(
    check: partial[RowCheck], tasks: list[tuple[str, Int[np.ndarray, " _"]]], workers: int
) -> Iterable[str]:
    found: dict[str, list[str]] = {}
    with progress() as bars, closing(run_tasks(check, tasks, workers=workers)) as results:
        bar = bars.add_task("configurations", total=sum(len(rows) for _, rows in tasks))
        for (name, rows), result in results:
            found[name] = [f"{name}: not verified: {result.reason}"] if isinstance(result, WorkerDied) else result
            bars.update(bar, advance=len(rows))
    return [difference for name in sorted(found) for difference in found[name]]


def _pick(rows: dict[str, int], num: int | None, seed: int) -> dict[str, Int[np.ndarray, " picked"]]:
    """Which rows of which objects are verified; objects without any are left out."""
    ends = np.cumsum([0, *rows.values()])
    total = int(ends[-1])
    chosen = np.arange(total) if num is None else np.sort(np.random.default_rng(seed).permutation(total)[:num])
    parts = np.split(chosen, np.searchsorted(chosen, ends[1:-1])) if rows else []
    return {name: part - start for name, part, start in zip(rows, parts, ends, strict=False) if len(part)}
