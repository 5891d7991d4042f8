"""A whole dataset in memory, as arrays."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.dataset.schema import BEHAVIOURS, INFEASIBLE, TURNS
from dexnudge.dataset.shards import column_matrix, complete_objects, read_cloud, read_shard
from dexnudge.errors import DatasetError, check_path


def turn_vectors(vectors: Float[Tensor, "*batch 3"], yaw: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3"]:
    """Return R_z(yaw) v; yaw [rad] is counter-clockwise seen from above and broadcasts against the batch."""
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    x, y, z = vectors.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y, z], dim=-1)


def turn_configurations(
    q: Float[Tensor, "*batch dimension"], yaw: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch dimension"]:
    """Return the hand carried around with the object: translation and both rotation columns turn, joint angles stay."""
    turned = turn_vectors(q[..., :9].unflatten(-1, (3, 3)), yaw[..., None])
    return torch.cat([turned.flatten(-2), q[..., 9:]], dim=-1)


def turn_clouds(
    clouds: Float[Tensor, "object point 6"], yaw: Float[Tensor, " object"]
) -> Float[Tensor, "object point 6"]:
    """Return turned points [m] and normals, one yaw per object."""
    return turn_vectors(clouds.unflatten(-1, (2, 3)), yaw[:, None, None]).flatten(-2)


VALIDATION_FRACTION = 0.05  # of the objects; the test set is made of other objects altogether


def hash_fraction(object_name: str) -> float:
    """Return a number in [0, 1) that depends on the name only and is spread evenly over names."""
    digest = hashlib.sha256(object_name.encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2.0**64


def split_objects(names: Sequence[str]) -> tuple[list[int], list[int]]:
    """Return the indices of training and validation objects.

    An object is held out when its hash falls below `VALIDATION_FRACTION`. With two or more objects neither side is
    empty: the smallest hash is then held out, or the largest one kept for training.
    """
    fractions = [hash_fraction(name) for name in names]
    number = sum(fraction < VALIDATION_FRACTION for fraction in fractions)
    if len(names) >= 2:
        number = min(max(number, 1), len(names) - 1)
    order = sorted(range(len(names)), key=fractions.__getitem__)
    return sorted(order[number:]), sorted(order[:number])


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """Every configuration of every object, resting frame, metres and radians.

    q: (row, 9 + d); object_index: (row) into object_names; behaviour: (row) into `schema.BEHAVIOURS`;
    direction_margin: (row, 16); clouds: (object, 1024, 6) points and normals; turn_margin: (row, 10) of `schema.TURNS`, -1
    where it was not judged; turns: (object, 10, 6) their twists, linear at the origin and angular, NaN where there is none.
    """

    manifest: Manifest
    object_names: tuple[str, ...]
    q: Float32[np.ndarray, "row dimension"]
    object_index: Int64[np.ndarray, " row"]
    behaviour: Int64[np.ndarray, " row"]
    direction_margin: Float32[np.ndarray, "row direction"]
    clouds: Float32[np.ndarray, "object point 6"]
    turn_margin: Float32[np.ndarray, "row turn"]
    turns: Float32[np.ndarray, "object turn 6"]

    def __len__(self) -> int:
        return len(self.q)


def load_datasets(folders: Sequence[Path | str]) -> Dataset:
    """Read several datasets of one hand as one; an object that is in two of them, lying and standing, counts as two.

    The manifest is that of the first. Raises DatasetError as `load_dataset` does, for no folder, for different hands, and
    where two of them hold the same rows of an object, as a folder that is given twice and a copy of it do.
    """
    if not folders:
        raise DatasetError("there is no dataset to read; expected at least one folder")
    parts = [load_dataset(folder) for folder in folders]
    first = parts[0].manifest
    for folder, part in zip(folders, parts, strict=True):
        if (part.manifest.hand, part.manifest.joint_names) != (first.hand, first.joint_names):
            raise DatasetError(
                f"{folder} is of hand {part.manifest.hand!r}, {folders[0]} of {first.hand!r}; expected datasets of one hand"
            )
    _check_distinct(folders, parts)
    before = np.cumsum([0, *(len(part.object_names) for part in parts)])
    arrays = ("q", "behaviour", "direction_margin", "clouds", "turn_margin", "turns")
    return Dataset(
        manifest=first,
        object_names=tuple(name for part in parts for name in part.object_names),
        object_index=np.concatenate([part.object_index + start for part, start in zip(parts, before, strict=False)]),
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays},
    )


def _check_distinct(folders: Sequence[Path | str], parts: Sequence[Dataset]) -> None:
    """Refuse rows that are there twice: they would count twice; DatasetError."""
    seen: dict[tuple[str, bytes], Path | str] = {}
    for folder, part in zip(folders, parts, strict=True):
        for index, name in enumerate(part.object_names):
            rows = part.q[part.object_index == index]
            key = (name, hashlib.sha256(rows.tobytes()).digest())
            if len(rows) and key in seen:
                raise DatasetError(
                    f"{folder} holds the same {len(rows)} configurations of {name} as {seen[key]}; expected each dataset "
                    "once; leave the folder, or its copy, out"
                )
            seen[key] = folder


def load_dataset(folder: Path | str, *, allow_incomplete: bool = False) -> Dataset:
    """Read the manifest and every shard.

    Raises DatasetError for a missing manifest, a truncated, foreign or outdated shard, and, unless `allow_incomplete`,
    for an object of the manifest that has neither a shard nor a recorded failure.
    """
    check_path("folder", folder, DatasetError)
    folder = Path(folder)
    manifest = read_manifest(folder)
    names = complete_objects(folder, manifest)
    missing = sorted(set(manifest.objects) - set(names) - set(manifest.failed_objects))
    if missing and not allow_incomplete:
        raise DatasetError(
            f"{folder} is incomplete: {len(missing)} of {len(manifest.objects)} objects have no shard "
            f"(first: {missing[0]}); resume `dexnudge dataset generate`, or allow an incomplete dataset."
        )
    parts = [_arrays(folder, manifest, name, index) for index, name in enumerate(names)]
    if not any(len(part["q"]) for part in parts):
        raise DatasetError(f"{folder} holds no configuration; run `dexnudge dataset generate` first.")
    arrays = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    return Dataset(manifest=manifest, object_names=tuple(names), **arrays)


def _arrays(folder: Path, manifest: Manifest, name: str, index: int) -> dict[str, np.ndarray]:
    """Return the arrays of a `Dataset` that has this object alone, at this place."""
    shard = read_shard(folder, manifest, name)
    labels = [BEHAVIOURS.index(label) for label in shard.table.column("behaviour").to_pylist()]
    unjudged = np.full((len(labels), len(TURNS)), INFEASIBLE, dtype=np.float32)
    turns = np.full((len(TURNS), 6), np.nan) if shard.turns is None else shard.turns
    return {
        "q": column_matrix(shard.table, "q"),
        "object_index": np.full(len(labels), index, dtype=np.int64),
        "behaviour": np.array(labels, dtype=np.int64),
        "direction_margin": column_matrix(shard.table, "direction_margin"),
        "clouds": read_cloud(folder, manifest, name)[None],
        "turn_margin": unjudged if shard.turns is None else column_matrix(shard.table, "turn_margin"),
        "turns": turns[None].astype(np.float32),
    }
