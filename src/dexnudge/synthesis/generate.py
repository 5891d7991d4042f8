"""Generate a dataset: one object at a time, in parallel, each object's shard written whole or not at all."""

import json
import time
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from datetime import datetime, timezone
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import Progress, TextColumn

from dexnudge.dataset.manifest import (
    MANIFEST_NAME,
    DamagedManifestError,
    Manifest,
    joint_groups,
    read_manifest,
    recorded_hand,
    write_manifest,
)
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import DamagedShardError, is_complete, read_whole, shard_path
from dexnudge.errors import DatasetError, HandError, InputError, OutputError, quote, what_failed, writing
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.atomic_files import TEMPORARY_PREFIX, remove_leftovers
from dexnudge.jobs.engines import Engine, run_tasks_by
from dexnudge.jobs.locks import LOCK_NAME
from dexnudge.jobs.processes import WorkerDied
from dexnudge.jobs.progress import progress
from dexnudge.objects.sets import BUILTIN_PREFIX, resolve_object_set
from dexnudge.synthesis.object_data import GenerationConfig, ObjectOutcome, ObjectTask
from dexnudge.synthesis.rebuilt_manifest import rebuilt_manifest
from dexnudge.version import __version__


def totals(counts: dict[str, dict[str, BehaviourCounts]]) -> dict[str, BehaviourCounts]:
    """Return the counts of all objects per behaviour, whatever the order in which the objects were done."""
    summed: dict[str, BehaviourCounts] = {}
    for name in sorted(counts):
        for behaviour, count in counts[name].items():
            summed[behaviour] = summed.get(behaviour, BehaviourCounts()) + count
    return dict(sorted(summed.items()))


LOG_NAME = "log.jsonl"
OURS = (MANIFEST_NAME, LOG_NAME, LOCK_NAME, TEMPORARY_PREFIX, "shard-", "object-")
"""How the names begin of what a generation that was killed before its first whole shard may have left."""
TOP_REASONS = 3  # rejections that the bar names


class GenerationLog:
    """Counts what this start of a run has done; one line of JSON for each object, as it ends."""

    def __init__(self, folder: Path, bars: Progress, *, total: int, finished: int) -> None:
        self._path = folder / LOG_NAME
        self._bars = bars
        self._bar = bars.add_task("objects", total=total, completed=finished, summary="")
        self._start = time.monotonic()
        self._counts, self._failed_objects, self._repaired_objects = BehaviourCounts(), 0, 0
        if self._path.is_file() and not self._path.read_bytes().endswith(b"\n"):
            self._append("\n")  # a writer that was killed has left half a line

    def write(self, event: str, **content: Any) -> None:
        """Append a line; OutputError when the disk is full."""
        line = {"time": datetime.now(timezone.utc).isoformat(timespec="milliseconds"), "event": event, **content}
        self._append(json.dumps(line) + "\n")

    def notify(self, message: str) -> None:
        """Print a message above the bar, on stderr."""
        self._bars.console.print(message, style="yellow", soft_wrap=True)

    def add(self, name: str, outcome: ObjectOutcome) -> None:
        """Count one object."""
        kept = sum(count.kept for count in outcome.counts.values())
        self._counts = sum(outcome.counts.values(), self._counts)
        if outcome.failed:
            self._failed_objects += 1
            result: dict[str, Any] = {"failed": outcome.failed, **({"trace": outcome.trace} if outcome.trace else {})}
            self.notify(f"object {name} failed: {outcome.failed}")
        else:
            result = {"counts": {behaviour: asdict(count) for behaviour, count in sorted(outcome.counts.items())}}
        if outcome.repairs:
            self._repaired_objects += 1
            result["repairs"] = list(outcome.repairs)
        self._bars.update(self._bar, advance=1, summary=self.summary())
        self.write("object", name=name, seconds=round(outcome.seconds, 3), kept=kept, **result)

    def summary(self) -> str:
        """Return rate, yield and the most frequent rejections in one line."""
        counts, seconds = self._counts, max(time.monotonic() - self._start, 1e-9)
        percent = 100.0 / max(counts.attempted, 1)
        commonest = Counter(counts.rejected).most_common(TOP_REASONS)
        reasons = ", ".join(f"{reason} {percent * number:.0f} %" for reason, number in commonest)
        rejections = f"; rejected: {reasons}" if reasons else ""
        return f"{counts.kept / seconds:.1f} kept/s, yield {percent * counts.kept:.1f} %{rejections}"

    def end(self, how: str) -> None:
        """Write the last line of this start."""
        seconds = time.monotonic() - self._start
        if self._repaired_objects:
            number = self._repaired_objects
            self.notify(f"{number} object{'s were' if number > 1 else ' was'} repaired when read; {LOG_NAME} says how")
        self.write(
            "end",
            how=how,
            seconds=round(seconds, 3),
            kept=self._counts.kept,
            attempted=self._counts.attempted,
            kept_per_second=round(self._counts.kept / max(seconds, 1e-9), 3),
            failed_objects=self._failed_objects,
            rejected=dict(Counter(self._counts.rejected).most_common()),
        )

    def _append(self, text: str) -> None:
        with writing(self._path, "expected a folder with free space"), self._path.open("a", encoding="utf-8") as file:
            file.write(text)


@contextmanager
def generation_log(folder: Path, *, total: int, finished: int) -> Iterator[GenerationLog]:
    """Yield a log with its bar while the block runs; its last line says how the block ended."""
    with progress(TextColumn("{task.fields[summary]}")) as bars:
        log = GenerationLog(folder, bars, total=total, finished=finished)
        try:
            yield log
        except KeyboardInterrupt:
            log.end("interrupted")
            raise
        log.end("done")


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
    """Generate what is missing in `out` and return the finished manifest.

    An object that fails is counted and named in the manifest, tried again at the next start, and the others go on.
    Started again after a stop, whole shards are kept and the others made anew. The same set, configuration, seed and
    versions give the same bytes, whatever the engine, the number of workers and the stops; only `log.jsonl`, which
    tells how the run went, differs.

    objects: a set as in `resolve_object_set`; out, and the meshes: on a Ray cluster in folders that all machines share;
    workers: processes of this machine; ray_address: of a running cluster, None starts one with `workers` cores.

    Raises:
        InputError: nothing to generate: no attempts, an empty set, a hand without fingertips; or no object could be.
        DatasetError: `out` holds a dataset of another hand, configuration, seed or version.
        OutputError: `out` cannot be written, for example because the disk is full; what is written is safe.
    """
    if config.non_prehensile + config.grasps == 0:
        raise InputError("there is nothing to attempt: non_prehensile and grasps are 0; expected one of them above 0")
    if not 0.0 <= config.upright <= 1.0:
        raise InputError(f"`upright` is {config.upright}; expected a share of the objects between 0 and 1")
    if not objects.startswith(BUILTIN_PREFIX) and Path(objects).exists():
        objects = str(Path(objects).resolve())  # workers on other machines have another working directory
    entries = resolve_object_set(objects, units=config.units, length=config.length)
    manifest = _open(out.resolve(), config, seed)
    names = sorted({*manifest.objects, *(entry.name for entry in entries)})
    done: dict[str, ObjectOutcome] = {}
    damaged: dict[str, str] = {}
    for name, shard in read_whole(out, manifest, [name for name in names if is_complete(out, name)]):
        if isinstance(shard, DamagedShardError):
            damaged[name] = str(shard)
            shard_path(out, name).unlink()
        else:
            done[name] = ObjectOutcome(mesh_hash=shard.mesh_hash, counts=shard.counts)
    manifest.objects = {name: done[name].mesh_hash if name in done else None for name in names}
    manifest.failed_objects, manifest.counts = {}, {}
    write_manifest(out, manifest)
    # In an order that mixes all kinds of objects, so that a run that is stopped early holds some of each.
    mixed = sorted(entries, key=lambda entry: zlib.crc32(entry.name.encode()))
    missing = [entry for entry in mixed if entry.name not in done]
    try:
        with generation_log(out, total=len(entries), finished=len(entries) - len(missing)) as log:
            log.write("start", engine=engine, workers=workers, missing=len(missing), damaged=damaged)
            for name, reason in damaged.items():
                log.notify(f"object {name} is generated again: {reason}")
            work = partial(ObjectTask, out.resolve(), replace(manifest, objects={}), config)
            results = run_tasks_by(engine, work, missing, workers=workers, ray_address=ray_address, isolated=True)
            with closing(results):
                for entry, result in results:
                    outcome = ObjectOutcome(failed=result.reason) if isinstance(result, WorkerDied) else result
                    _enter(manifest, out, entry.name, outcome)
                    if not outcome.failed:
                        done[entry.name] = outcome
                    log.add(entry.name, outcome)
        counts = totals({name: outcome.counts for name, outcome in done.items()})
        manifest.counts = {behaviour: asdict(count) for behaviour, count in counts.items()}
        write_manifest(out, manifest)
    except OutputError as error:
        safe = sum(is_complete(out, entry.name) for entry in entries)
        raise OutputError(
            f"{error} {safe} of {len(entries)} objects are complete and safe in {out}; make room, then give the same "
            "command again: it goes on with the others."
        ) from error
    finally:
        remove_leftovers(out)  # of workers that were stopped while they wrote
    if not done:
        name, reason = next(iter(sorted(manifest.failed_objects.items())))
        raise DatasetError(
            f"none of the {len(entries)} objects of {objects} could be generated; the first, {name}: {reason}"
        )
    return manifest


def _open(out: Path, config: GenerationConfig, seed: int) -> Manifest:
    """The manifest to go on with, which must be of the same hand, configuration, seed and versions; makes the folder."""
    hand = load_hand(config.hand)
    if not hand.fingertips:
        raise HandError(
            f"hand '{hand.name}' has no fingertips, so nothing that could touch an object; expected at least one "
            "fingertip link; name them under 'fingertips' in the hand's YAML"
        )
    if config.grasps and len(hand.fingertips) == 1:
        raise HandError(
            f"hand '{hand.name}' has one fingertip, and a grasp needs two digits that face each other; expected at least "
            "two fingertip links, or no attempts at grasps (`grasps` 0)"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({what_failed(error)}); choose another folder") from error
    wanted = Manifest(
        hand=hand.name,
        joint_names=hand.joint_names,
        joint_groups=joint_groups(hand),
        sliding_joints=tuple(np.array(hand.joint_names)[hand.sliding].tolist()),
        objects={},
        config=asdict(replace(config, hand=recorded_hand(config.hand, hand, out))),
        seed=seed,
        versions={"dexnudge": __version__, **{package: version(package) for package in PACKAGES}},
    )
    found = _found(out, wanted)
    if _differing(found, wanted):
        shards = rebuilt_manifest(out, wanted)
        found = shards if shards and not _differing(shards, wanted) else found  # the manifest alone has changed
    if differing := _differing(found, wanted):
        label = differing[0]
        expected, got = getattr(wanted, label), getattr(found, label)
        if isinstance(expected, dict):
            key = next(key for key in (*expected, *got) if expected.get(key) != got.get(key))
            label = f"version of {key}" if label == "versions" else f"`{key}`"
            expected, got = expected.get(key), got.get(key)
        raise DatasetError(
            f"{out} holds a dataset with another {label}: expected {expected!r}, got {got!r}; choose another folder, or "
            f"the same {label}"
        )
    remove_leftovers(out)
    return replace(found, joint_groups=wanted.joint_groups, sliding_joints=wanted.sliding_joints)  # no shard has them


def _differing(found: Manifest, wanted: Manifest) -> list[str]:
    """What a run that goes on must have in common with what is there, and has not."""
    labels = ("hand", "joint_names", "config", "seed", "versions")
    return [label for label in labels if getattr(found, label) != getattr(wanted, label)]


def _found(out: Path, wanted: Manifest) -> Manifest:
    """The manifest that is there; where it is missing or damaged, that of the shards there, or else `wanted`."""
    try:
        return read_manifest(out)
    except DamagedManifestError:
        rebuilt = rebuilt_manifest(out, wanted)
    if rebuilt is None:
        foreign = sorted(entry.name for entry in out.iterdir() if not entry.name.startswith(OURS))
        if foreign:
            raise OutputError(
                f"{out} holds {quote(foreign[0])} and no dataset; expected a new folder, or one that `dexnudge dataset "
                "generate` made; choose another `out`"
            )
        return wanted
    if rebuilt.joint_names == wanted.joint_names:  # else another hand's, whose joints' groups are not known here
        write_manifest(out, rebuilt)
    return rebuilt


def _enter(manifest: Manifest, out: Path, name: str, outcome: ObjectOutcome) -> None:
    """Enter into the manifest what became of an object."""
    if outcome.failed:
        manifest.failed_objects[name] = outcome.failed
        del manifest.objects[name]
        return
    if not is_complete(out, name):
        raise OutputError(
            f"the shard of {name!r} was written on another machine, which does not share {out} with this "
            "one; expected a folder that all machines of the cluster share."
        )
    manifest.objects[name] = outcome.mesh_hash
