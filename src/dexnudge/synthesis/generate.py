"""Generates a dataset: one object at a time, in parallel, each object's shard written whole or not at all."""

import zlib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from dexnudge import __version__
from dexnudge.dataset.atomic import remove_leftovers
from dexnudge.dataset.digits import digit_joints
from dexnudge.dataset.manifest import Manifest, write_manifest
from dexnudge.dataset.shards import is_complete
from dexnudge.errors import DatasetError, HandError, InputError, OutputError
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.answers import WorkerDied
from dexnudge.jobs.processes import run_tasks
from dexnudge.jobs.ray_cluster import run_tasks_on_ray
from dexnudge.objects.sets import BUILTIN_PREFIX, ObjectEntry, resolve_object_set
from dexnudge.synthesis.finished import Finished, open_manifest, read_finished, totals
from dexnudge.synthesis.generation_log import GenerationLog, generation_log
from dexnudge.synthesis.object_task import GenerationConfig, ObjectOutcome, ObjectTask

Engine = Literal["processes", "ray"]
# What the bytes of a dataset depend on, besides its configuration and seed.
PACKAGES = ("mujoco", "numpy", "pyarrow", "scipy", "torch", "trimesh", "warp-lang")


def generate_dataset(
    objects: str,
    out: Path,
    config: GenerationConfig,
    *,
    seed: int = 0,
    workers: int = 2,
    engine: Engine = "processes",
    ray_address: str | None = None,
) -> Manifest:
    """Generates what is missing in `out` and returns the finished manifest.

    An object that fails is counted and named in the manifest, tried again at the next start, and the others go on.
    Started again after a stop, whole shards are kept and the others made anew. The same set, configuration, seed and
    versions give the same bytes, whatever the engine, the number of workers and the stops; only `log.jsonl`, which
    tells how the run went, differs.

    Args:
        objects: a set as in `resolve_object_set`.
        out: folder of the dataset; on a Ray cluster one that all machines share, as must be the meshes.
        config: what to generate for each object.
        seed: of the run; each object's draws depend on it and the object's name.
        workers: processes of this machine.
        engine: "processes", or "ray" for a Ray cluster.
        ray_address: of a running cluster; None starts one on this machine, with `workers` cores.

    Raises:
        InputError: nothing to generate: no attempts, an empty set, a hand without fingertips; or no object could be.
        DatasetError: `out` holds a dataset of another hand, configuration, seed or version.
        OutputError: `out` cannot be written, for example because the disk is full; what is written is safe.
    """
    if config.non_prehensile + config.grasps == 0:
        raise InputError("there is nothing to attempt: non_prehensile and grasps are 0; expected one of them above 0")
    if not objects.startswith(BUILTIN_PREFIX) and Path(objects).exists():
        objects = str(Path(objects).resolve())  # workers on other machines have another working directory
    entries = resolve_object_set(objects, units=config.units, length=config.length)
    manifest = _open(out.resolve(), load_hand(config.hand), config, seed)
    names = sorted({*manifest.objects, *(entry.name for entry in entries)})
    finished = read_finished(out, manifest, names)
    manifest.objects = {name: finished.mesh_hash.get(name) for name in names}
    manifest.failed_objects, manifest.counts = {}, {}
    write_manifest(out, manifest)
    # In an order that mixes all kinds of objects, so that a run that is stopped early holds some of each.
    mixed = sorted(entries, key=lambda entry: zlib.crc32(entry.name.encode()))
    missing = [entry for entry in mixed if entry.name not in finished.mesh_hash]
    try:
        with generation_log(out, total=len(entries), finished=len(entries) - len(missing)) as log:
            log.write("start", engine=engine, workers=workers, missing=len(missing), damaged=finished.damaged)
            for name, reason in finished.damaged.items():
                log.tell(f"object {name} is generated again: {reason}")
            work = partial(ObjectTask, out.resolve(), replace(manifest, objects={}), config)
            if engine == "ray":
                results = run_tasks_on_ray(work, missing, workers=workers, address=ray_address)
            else:
                results = run_tasks(work, missing, workers=workers, isolated=True)
            with closing(results):
                _collect(results, out, manifest, finished, log)
        manifest.counts = {behaviour: asdict(count) for behaviour, count in totals(finished.counts).items()}
        write_manifest(out, manifest)
    except OutputError as error:
        safe = sum(is_complete(out, entry.name) for entry in entries)
        raise OutputError(
            f"{error} {safe} of {len(entries)} objects are complete and safe in {out}; make room, then give the same "
            "command again: it goes on with the others."
        ) from error
    finally:
        remove_leftovers(out)  # of workers that were stopped while they wrote
    if not finished.counts:
        name, reason = next(iter(sorted(manifest.failed_objects.items())))
        raise DatasetError(
            f"none of the {len(entries)} objects of {objects} could be generated; the first, {name}: {reason}"
        )
    return manifest


def _open(out: Path, hand: Hand, config: GenerationConfig, seed: int) -> Manifest:
    """The manifest to go on with; makes the folder."""
    if not hand.fingertips:
        raise HandError(
            f"hand '{hand.name}' has no fingertips, so nothing that could touch an object; expected at least one "
            "fingertip link; name them under 'fingertips' in the hand's YAML"
        )
    if config.grasps and len(hand.fingertips) == 1:
        raise HandError(
            f"hand '{hand.name}' has one fingertip, and a grasp needs two digits that face each other; expected at least "
            "two fingertip links, or no attempts at grasps (--grasps 0)"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({error.strerror}); choose another folder") from error
    wanted = Manifest(
        hand=hand.name,
        joint_names=hand.joint_names,
        digit_joints=digit_joints(hand),
        objects={},
        config=asdict(config),
        seed=seed,
        versions={"dexnudge": __version__, **{package: version(package) for package in PACKAGES}},
    )
    manifest = open_manifest(out, wanted)
    remove_leftovers(out)
    return manifest


def _collect(
    results: Iterator[tuple[ObjectEntry, ObjectOutcome | WorkerDied]],
    out: Path,
    manifest: Manifest,
    finished: Finished,
    log: GenerationLog,
) -> None:
    """Count every object as it ends: done, or failed with the reason."""
    for entry, result in results:
        outcome = ObjectOutcome(failed=result.reason) if isinstance(result, WorkerDied) else result
        if not outcome.failed and not is_complete(out, entry.name):
            raise OutputError(
                f"the shard of {entry.name!r} was written on another machine, which does not share {out} with this "
                "one; expected a folder that all machines of the cluster share."
            )
        if outcome.failed:
            manifest.failed_objects[entry.name] = outcome.failed
            del manifest.objects[entry.name]
        else:
            manifest.objects[entry.name] = outcome.mesh_hash
            finished.mesh_hash[entry.name] = outcome.mesh_hash
            finished.counts[entry.name] = outcome.counts
        log.add(entry.name, outcome)
