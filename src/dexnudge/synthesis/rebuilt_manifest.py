"""A dataset's manifest made anew from its shards, each of which says where it comes from."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from dexnudge.dataset.manifest import Manifest, is_object_name
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import AGAIN, DamagedShardError, ShardHeader, read_header
from dexnudge.jobs.json_files import from_fields


def rebuilt_manifest(folder: Path, like: Manifest) -> Manifest | None:
    """Return the manifest of the shards in `folder`; None where none of them is whole.

    Hand, configuration, seed and versions are those of the first whole shard; a later one that differs is refused when it
    is read. The object of a damaged shard has no hash, as one that is still to be generated. Copies under other names
    are passed over.
    like: has the joints of the same hand, as their groups stand in the manifest alone.
    """
    found: Manifest | None = None
    objects: dict[str, str | None] = {}
    counts: dict[str, BehaviourCounts] = {}
    for path in sorted(folder.glob("shard-*.parquet")):
        name = path.stem.removeprefix("shard-")
        if not is_object_name(name):
            continue
        objects[name] = None
        says: dict[str, Any] = {"error": DamagedShardError, "again": AGAIN, "others": True}
        try:
            content = read_header(path)
            own = from_fields(content, ShardHeader, str(path), **says)
            if own.object != name:
                del objects[name]
                continue
            joints = {
                "joint_groups": like.joint_groups,
                "sliding_joints": like.sliding_joints,
                "objects": {},
                "counts": {},
            }
            found = found or from_fields({**content, **joints}, Manifest, str(path), **says)
        except DamagedShardError:
            continue
        objects[name] = own.mesh_sha256
        for behaviour, count in own.counts.items():
            counts[behaviour] = counts.get(behaviour, BehaviourCounts()) + count
    if found is None:
        return None
    return replace(found, objects=objects, counts={name: asdict(count) for name, count in sorted(counts.items())})
