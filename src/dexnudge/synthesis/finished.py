"""What an earlier start of a generation has left: whole shards, damaged ones, and another run's."""

from dataclasses import dataclass, field
from pathlib import Path

from dexnudge.dataset.manifest import MANIFEST_NAME, Manifest, read_manifest
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import DamagedShardError, is_complete, read_cloud, read_shard, shard_path
from dexnudge.errors import DatasetError


@dataclass(frozen=True)
class Finished:
    """Objects that are done: name -> mesh hash and counts. damaged: those that must be made again -> what is wrong."""

    mesh_hash: dict[str, str] = field(default_factory=dict)
    counts: dict[str, dict[str, BehaviourCounts]] = field(default_factory=dict)
    damaged: dict[str, str] = field(default_factory=dict)


def open_manifest(folder: Path, wanted: Manifest) -> Manifest:
    """The manifest in `folder`, or `wanted` where there is none.

    Raises:
        DatasetError: the folder holds a dataset of another format version, hand, configuration, seed, or of other
            versions of what decides the numbers.
    """
    if not (folder / MANIFEST_NAME).exists():
        return wanted
    found = read_manifest(folder)
    for label in ("hand", "joint_names", "config", "seed", "versions"):
        if getattr(found, label) != getattr(wanted, label):
            raise DatasetError(
                f"{folder} holds a dataset with another {label}: expected {getattr(wanted, label)!r}, "
                f"got {getattr(found, label)!r}; choose another folder, or the same {label}"
            )
    return found


def read_finished(folder: Path, manifest: Manifest, names: list[str]) -> Finished:
    """Read every shard that is there, to the last byte, and remove those that are damaged.

    Raises:
        DatasetError: a shard belongs to another dataset.
    """
    finished = Finished()
    for name in names:
        if not is_complete(folder, name):
            continue
        try:
            shard = read_shard(folder, manifest, name)
            read_cloud(folder, manifest, name)
        except DamagedShardError as error:
            finished.damaged[name] = str(error)
            shard_path(folder, name).unlink()
            continue
        finished.mesh_hash[name] = shard.mesh_hash
        finished.counts[name] = shard.counts
    return finished


def totals(counts: dict[str, dict[str, BehaviourCounts]]) -> dict[str, BehaviourCounts]:
    """Counts of all objects per behaviour, whatever the order in which the objects were done."""
    summed: dict[str, BehaviourCounts] = {}
    for name in sorted(counts):
        for behaviour, count in counts[name].items():
            summed[behaviour] = summed.get(behaviour, BehaviourCounts()) + count
    return dict(sorted(summed.items()))
