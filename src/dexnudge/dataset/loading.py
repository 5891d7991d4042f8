"""A whole dataset in memory, as arrays."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.dataset.schema import BEHAVIOURS, CLOUD_POINTS, NUM_DIRECTIONS, POSE_DIMENSIONS
from dexnudge.dataset.shards import is_complete, read_cloud, read_shard
from dexnudge.errors import DatasetError


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """Every configuration of every object, resting frame, metres and radians.

    q: (row, 9 + d); object_index: (row) into object_names; behaviour: (row) into `schema.BEHAVIOURS`;
    direction_margin: (row, 16); clouds: (object, 1024, 6) points and normals.
    """

    manifest: Manifest
    object_names: tuple[str, ...]
    q: Float32[np.ndarray, "row dimension"]
    object_index: Int64[np.ndarray, " row"]
    behaviour: Int64[np.ndarray, " row"]
    direction_margin: Float32[np.ndarray, "row direction"]
    clouds: Float32[np.ndarray, "object point 6"]

    def __len__(self) -> int:
        return len(self.q)


def load_dataset(folder: Path | str, *, allow_incomplete: bool = False) -> Dataset:
    """Read the manifest and every shard.

    Raises DatasetError for a missing manifest, a truncated, foreign or outdated shard, and, unless `allow_incomplete`,
    for an object of the manifest that has neither a shard nor a recorded failure.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    names = [name for name in sorted(manifest.objects) if is_complete(folder, name)]
    missing = [name for name in manifest.objects if name not in set(names) and name not in manifest.failed_objects]
    if missing and not allow_incomplete:
        raise DatasetError(
            f"{folder} is incomplete: {len(missing)} of {len(manifest.objects)} objects have no shard "
            f"(first: {missing[0]}); resume `dexnudge dataset generate`, or allow an incomplete dataset."
        )
    behaviour_index = {behaviour: index for index, behaviour in enumerate(BEHAVIOURS)}
    dimension = POSE_DIMENSIONS + len(manifest.joint_names)
    q, object_index, behaviours, margins, clouds = [], [], [], [], []
    for index, name in enumerate(names):
        shard = read_shard(folder, manifest, name)
        q.append(shard.column_matrix("q"))
        margins.append(shard.column_matrix("direction_margin"))
        labels = [behaviour_index[label] for label in shard.table.column("behaviour").to_pylist()]
        behaviours.append(np.array(labels, dtype=np.int64))
        object_index.append(np.full(len(labels), index, dtype=np.int64))
        clouds.append(read_cloud(folder, manifest, name))
    if not any(len(part) for part in q):
        raise DatasetError(f"{folder} holds no configuration; run `dexnudge dataset generate` first.")
    return Dataset(
        manifest=manifest,
        object_names=tuple(names),
        q=np.concatenate(q).reshape(-1, dimension),
        object_index=np.concatenate(object_index),
        behaviour=np.concatenate(behaviours),
        direction_margin=np.concatenate(margins).reshape(-1, NUM_DIRECTIONS),
        clouds=np.stack(clouds).reshape(-1, CLOUD_POINTS, 6),
    )
