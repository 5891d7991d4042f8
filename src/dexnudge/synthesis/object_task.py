"""What one worker does for one object: load its mesh, generate, write its shard."""

import hashlib
import time
import traceback
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import trimesh

from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import write_shard
from dexnudge.errors import DexnudgeError, OutputError
from dexnudge.hands.registry import load_hand
from dexnudge.objects.sets import ObjectEntry
from dexnudge.synthesis.object_data import generate_object


@dataclass(frozen=True)
class GenerationConfig:
    """What to generate for each object.

    non_prehensile, grasps: attempts per object and kind; 0 leaves a kind out.
    """

    hand: str = "shadow_lite"
    units: str = "m"
    length: float | None = None
    non_prehensile: int = 256
    grasps: int = 256


@dataclass(frozen=True, kw_only=True)
class ObjectOutcome:
    """What became of one object: its shard is written, or `failed` says why not.

    mesh_hash: see `mesh_hash`; counts: per behaviour; trace: where an error came from that nobody foresaw.
    """

    mesh_hash: str = ""
    counts: dict[str, BehaviourCounts] = field(default_factory=dict)
    failed: str = ""
    trace: str = ""
    seconds: float = 0.0


class ObjectTask:
    """Generates one object after another into the folder `out`, with the hand loaded once."""

    def __init__(self, out: Path, manifest: Manifest, config: GenerationConfig) -> None:
        self._out = out
        self._manifest = manifest
        self._config = config
        self._hand = load_hand(config.hand)

    def __call__(self, entry: ObjectEntry) -> ObjectOutcome:
        """Write the shard of one object. Whatever goes wrong with it concerns no other object, except for the output.

        Raises:
            OutputError: the shard cannot be written, for example because the disk is full.
        """
        start = time.perf_counter()
        try:
            mesh = entry.load()
            digest = mesh_hash(mesh)
            rows, cloud, counts = generate_object(
                self._hand,
                mesh,
                non_prehensile=self._config.non_prehensile,
                grasps=self._config.grasps,
                generator=np.random.default_rng(object_seed(self._manifest.seed, entry.name)),
                seed=self._manifest.seed,
            )
            manifest = replace(self._manifest, objects={entry.name: digest})
            write_shard(self._out, manifest, entry.name, rows, cloud, counts)
        except OutputError:
            raise
        except DexnudgeError as error:
            return ObjectOutcome(failed=str(error), seconds=time.perf_counter() - start)
        except Exception as error:  # noqa: BLE001  one odd mesh among thousands must not end a run of hours
            failed = f"{type(error).__name__}: {error}"
            return ObjectOutcome(failed=failed, trace=traceback.format_exc(), seconds=time.perf_counter() - start)
        return ObjectOutcome(mesh_hash=digest, counts=counts, seconds=time.perf_counter() - start)


def mesh_hash(mesh: trimesh.Trimesh) -> str:
    """SHA-256 of the vertices (float64, metres) and faces."""
    digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices, dtype=np.float64).tobytes())
    digest.update(np.ascontiguousarray(mesh.faces, dtype=np.int64).tobytes())
    return digest.hexdigest()


def object_seed(seed: int, name: str) -> list[int]:
    """Entropy of one object's draws: depends on nothing but the run's seed and the object's name."""
    return [seed, zlib.crc32(name.encode())]
