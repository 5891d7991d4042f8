"""Generates a dataset: one object at a time, in parallel, each object's shard written whole or not at all."""

import hashlib
import multiprocessing
import zlib
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from dexnudge import __version__
from dexnudge.dataset.atomic import remove_leftovers
from dexnudge.dataset.digits import digit_joints
from dexnudge.dataset.manifest import Manifest, read_manifest, write_manifest
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import is_complete, read_shard, write_shard
from dexnudge.errors import DatasetError, DexnudgeError
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.sets import ObjectEntry, resolve_object_set
from dexnudge.synthesis.object_data import generate_object


@dataclass(frozen=True)
class GenerationConfig:
    """What to generate for each object.

    non_prehensile, grasps: attempts per object and kind.
    """

    hand: str = "shadow_lite"
    units: str = "m"
    length: float | None = None
    non_prehensile: int = 256
    grasps: int = 256


def generate_dataset(objects: str, out: Path, config: GenerationConfig, *, seed: int = 0, workers: int = 2) -> Manifest:
    """Generates what is missing in `out` and returns the finished manifest.

    An object that fails is counted and named in the manifest, and the others go on. Started again after a stop, whole
    shards are kept and the others made anew; the same seed gives the same rows whatever the number of workers.

    Raises:
        DatasetError: `out` holds a dataset of another hand, configuration or seed.
    """
    entries = resolve_object_set(objects, units=config.units, length=config.length)
    hand = load_hand(config.hand)
    out.mkdir(parents=True, exist_ok=True)
    manifest = _open_manifest(out, hand, config, seed)
    remove_leftovers(out)
    missing = [entry for entry in entries if not is_complete(out, entry.name)]
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns) as progress, _pool(workers) as pool:
        task = progress.add_task("objects", total=len(entries), completed=len(entries) - len(missing))
        # Meshes are loaded here and not in the workers, so that a broken one is named before the work begins.
        running = {}
        for entry in missing:
            mesh = _load(entry, manifest)
            if mesh is None:
                progress.advance(task)
            else:
                manifest.objects[entry.name] = mesh_hash(mesh)
                running[pool.submit(_work, entry.name, mesh, out, manifest, config, seed)] = entry.name
        write_manifest(out, manifest)
        kept = 0
        for future in as_completed(running):
            error, kept_here = future.result()
            if error:
                manifest.failed_objects[running[future]] = error
                manifest.objects.pop(running[future], None)
            kept += kept_here
            progress.update(task, advance=1, description=f"objects ({kept} kept)")
    manifest.counts = _totals(out, manifest)
    write_manifest(out, manifest)
    return manifest


def mesh_hash(mesh: trimesh.Trimesh) -> str:
    """SHA-256 of the vertices (float64, metres) and faces."""
    digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices, dtype=np.float64).tobytes())
    digest.update(np.ascontiguousarray(mesh.faces, dtype=np.int64).tobytes())
    return digest.hexdigest()


def object_seed(seed: int, name: str) -> list[int]:
    """Entropy of one object's draws: depends on nothing but the run's seed and the object's name."""
    return [seed, zlib.crc32(name.encode())]


def _pool(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker)


def _start_worker() -> None:
    torch.set_num_threads(1)  # one core per worker


_HANDS: dict[str, Hand] = {}


def _work(
    name: str, mesh: trimesh.Trimesh, out: Path, manifest: Manifest, config: GenerationConfig, seed: int
) -> tuple[str, int]:
    """(what failed, or "", rows kept) for one object; runs in a worker."""
    if config.hand not in _HANDS:
        _HANDS[config.hand] = load_hand(config.hand)
    try:
        rows, cloud, counts = generate_object(
            _HANDS[config.hand],
            mesh,
            non_prehensile=config.non_prehensile,
            grasps=config.grasps,
            generator=np.random.default_rng(object_seed(seed, name)),
            seed=seed,
        )
        write_shard(out, manifest, name, rows, cloud, counts)
    except DexnudgeError as error:
        return str(error), 0
    return "", len(rows)


def _load(entry: ObjectEntry, manifest: Manifest) -> trimesh.Trimesh | None:
    try:
        mesh = entry.load()
    except DexnudgeError as error:
        manifest.failed_objects[entry.name] = str(error)
        return None
    manifest.failed_objects.pop(entry.name, None)
    return mesh


def _open_manifest(out: Path, hand: Hand, config: GenerationConfig, seed: int) -> Manifest:
    wanted = Manifest(
        hand=hand.name,
        joint_names=hand.joint_names,
        digit_joints=digit_joints(hand),
        objects={},
        config=asdict(config),
        seed=seed,
        versions={"dexnudge": __version__, "torch": torch.__version__, "numpy": np.__version__},
    )
    if not (out / "manifest.json").exists():
        return wanted
    found = read_manifest(out)
    for label in ("hand", "config", "seed"):
        if getattr(found, label) != getattr(wanted, label):
            raise DatasetError(
                f"{out} holds a dataset with another {label}: expected {getattr(wanted, label)!r}, "
                f"got {getattr(found, label)!r}; choose another folder, or the same {label}"
            )
    return found


def _totals(out: Path, manifest: Manifest) -> dict[str, dict[str, object]]:
    totals: dict[str, BehaviourCounts] = {}
    for name in (name for name in manifest.objects if is_complete(out, name)):
        for behaviour, counts in read_shard(out, manifest, name).counts.items():
            totals[behaviour] = totals.get(behaviour, BehaviourCounts()) + counts
    return {behaviour: asdict(counts) for behaviour, counts in totals.items()}
