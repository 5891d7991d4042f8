"""What a dataset holds of one object: configurations generated, verified, labelled and counted, and its shard."""

import hashlib
import time
import traceback
import zlib
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from jaxtyping import Float

from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.schema import BehaviourCounts, ConfigurationRow, round_configuration
from dexnudge.dataset.shards import write_shard
from dexnudge.energies.descent import pose_from_configuration
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.energies.terms import TermWeights
from dexnudge.errors import DatasetError, DexnudgeError, OutputError
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_points import object_cloud, surface_points
from dexnudge.geometry.transforms import resting_origin
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.builtin import is_builtin
from dexnudge.objects.sets import ObjectEntry, object_mesh, resolve_object_set
from dexnudge.scenes.resting import resting_pose, standing_pose
from dexnudge.synthesis.acceptance import (
    GraspVerifier,
    NonPrehensileVerifier,
    behaviour_of,
    floating_scene,
    geometry_reasons,
    resting_scene,
)
from dexnudge.synthesis.grasps import GraspConfig, descend_to_grasp
from dexnudge.synthesis.nonprehensile import NonPrehensileConfig, descend_to_contact

BATCH = 256  # hands that descend together
TARGET_SPACING = 0.004  # [m] between the surface points that fingertips may aim at
OBVIOUSLY_DEEP = 0.0015  # [m] on guiding points: not worth the exact check
OUT_OF_REACH = 0.003  # [m] from the object to the nearest fingertip: not worth it either
SQUEEZES = 0.3  # share of the attempts at an object that stands which start with the thumb opposite the fingers
SQUEEZED_HEIGHT = (0.5, 0.95)  # of such an object's height, where they take hold


class GeneratedObject(NamedTuple):
    """Kept rows, surface points, counts per behaviour, and the twists of `TURNS` (see `Shard`) of one object."""

    rows: list[ConfigurationRow]
    cloud: Float[np.ndarray, "point 6"]
    counts: dict[str, BehaviourCounts]
    turns: Float[np.ndarray, "turn 6"]


def generate_object(
    hand: Hand,
    mesh: trimesh.Trimesh,
    *,
    non_prehensile: int,
    grasps: int,
    generator: np.random.Generator,
    seed: int,
    upright: bool = False,
) -> GeneratedObject:
    """Return what is generated for one object, in its resting frame.

    mesh: metres, any frame; non_prehensile, grasps: attempts; seed: what the rows are labelled with; upright: whether it
    stands on its end.
    """
    mesh = at_rest(mesh, upright=upright)
    surface = surface_points(mesh, spacing=TARGET_SPACING)
    centre = centre_of_mass(mesh)
    rows: list[ConfigurationRow] = []
    counts = {behaviour: BehaviourCounts() for behaviour in ("push", "press", "hook", "grasp")}
    scene = resting_scene(mesh)
    verifier = NonPrehensileVerifier(hand, scene)

    if non_prehensile:
        fields = build_scene_fields(mesh, scene.environment_mesh)
        squeezes = round(SQUEEZES * non_prehensile) if upright and len(hand.fingertips) > 1 else 0
        for batch in _batches(non_prehensile - squeezes):
            config = NonPrehensileConfig(batch=batch)
            q, intents = descend_to_contact(
                hand, fields, surface, centre, config=config, generator=generator, upright=upright
            )
            _verify(hand, fields, q.numpy(), intents, verifier, rows, counts, seed)
        for batch in _batches(squeezes):
            height = mesh.bounds[0, 2] + generator.uniform(*SQUEEZED_HEIGHT) * mesh.extents[2]
            place = np.array([*centre[:2], height])
            squeeze = GraspConfig(batch=batch, weights=replace(GraspConfig.weights, environment=8.0))
            q = descend_to_grasp(hand, fields, surface, place, config=squeeze, generator=generator)
            _verify(hand, fields, q.numpy(), ["push"] * batch, verifier, rows, counts, seed)

    if grasps:
        fields = build_scene_fields(mesh, None)
        grasp_verifier = GraspVerifier(hand, floating_scene(mesh))
        for batch in _batches(grasps):
            grasp_config = GraspConfig(batch=batch)
            q = descend_to_grasp(hand, fields, surface, centre, config=grasp_config, generator=generator)
            _verify(hand, fields, q.numpy(), ["grasp"] * batch, grasp_verifier, rows, counts, seed)
    return GeneratedObject(rows, object_cloud(mesh).numpy(), counts, verifier.turns)


def at_rest(mesh: trimesh.Trimesh, *, upright: bool = False) -> trimesh.Trimesh:
    """Return a copy in its resting frame, the frame of every configuration in a dataset: see `schema`.

    upright: standing on its end, where it can; else, and where it cannot, lying on its most stable face.
    """
    resting = mesh.copy()
    standing = standing_pose(resting) if upright else None
    resting.apply_transform(resting_pose(resting) if standing is None else standing)
    resting.apply_translation(-resting_origin(resting))
    return resting


class ObjectMeshes:
    """The meshes of a dataset's objects. objects: the set that they come from; None stands for built-in objects."""

    def __init__(self, manifest: Manifest, objects: str | None) -> None:
        self._objects = objects
        self._upright = float(str(manifest.config.get("upright", 0.0)))
        length = manifest.config.get("length")
        length = float(length) if isinstance(length, int | float) else None
        if objects is None:
            entries = [
                ObjectEntry(name, partial(object_mesh, name, length=length))
                for name in manifest.objects
                if is_builtin(name)
            ]
        else:
            entries = resolve_object_set(objects, units=str(manifest.config.get("units", "m")), length=length)
        self._known = {entry.name: entry for entry in entries}

    def check_known(self, name: str) -> None:
        """Raise DatasetError for an object that is not in the set."""
        if name not in self._known:
            raise DatasetError(
                f"the mesh of {name!r} is not in {self._objects or 'the built-in objects'}; expected the set that the "
                "dataset was generated from; give it as `objects`"
            )

    def at_rest(self, name: str, digest: str | None) -> trimesh.Trimesh:
        """Return one object's mesh [m], resting frame; raises DatasetError unless `digest` is its `mesh_hash`."""
        self.check_known(name)
        mesh = self._known[name].load()
        if mesh_hash(mesh) != digest:
            found = f"in {self._objects}" if self._objects else "of the built-in object with that name"
            mend = "correct `objects`" if self._objects else "give it as `objects`"
            raise DatasetError(
                f"the mesh of {name!r} {found} is not the one that the dataset was generated from; expected the set that "
                f"it was generated from; {mend}"
            )
        return at_rest(mesh, upright=stands(name, self._upright))


def stands(name: str, share: float) -> bool:
    """Return whether an object is among the `share` of a dataset's objects that stand on their end: by its name alone."""
    return zlib.crc32(f"upright {name}".encode()) < share * 2**32


def _batches(total: int) -> list[int]:
    return [min(BATCH, total - start) for start in range(0, total, BATCH)]


def _verify(
    hand: Hand,
    fields: WarpStruct,
    q: Float[np.ndarray, "n coordinates"],
    intents: list[str],
    verifier: NonPrehensileVerifier | GraspVerifier,
    rows: list[ConfigurationRow],
    counts: dict[str, BehaviourCounts],
    seed: int,
) -> None:
    """Adds kept configurations to `rows` and every attempt to `counts`; what is judged is what will be stored."""
    q = round_configuration(q.astype(np.float64), sliding=hand.sliding)
    reasons = _hopeless(hand, fields, q)
    promising = [row for row, reason in enumerate(reasons) if not reason]
    verified = verifier(q[promising])
    behaviours = list(intents)
    for index, row in enumerate(promising):
        reasons[row] = verified.reason[index]
        if not reasons[row]:
            margin, contacts = verified.direction_margin[index], verified.contacts[index]
            if intents[row] != "grasp":
                behaviours[row] = behaviour_of(contacts, margin, q[row, :3], verified.turn_margin[index])
            rows.append(ConfigurationRow(behaviour=behaviours[row], q=q[row], seed=seed, **verified.columns(index)))
    for behaviour, reason in zip(behaviours, reasons, strict=True):
        counts[behaviour] += BehaviourCounts(attempted=1, kept=int(not reason), rejected={reason: 1} if reason else {})


def _hopeless(hand: Hand, fields: WarpStruct, q: Float[np.ndarray, "n coordinates"]) -> list[str]:
    """Reason to reject before the exact check, from guiding points and grids; "" where the check must decide."""
    energy = HandEnergy(hand, fields, len(q), TermWeights())
    tips = hand.fingertip_indices
    energy.contact_weight[:, tips] = 1.0
    energy(pose_from_configuration(torch.as_tensor(q, dtype=torch.float32)))
    depth = energy.depth.amax(dim=1).numpy()
    distance = energy.contact_distance[:, tips].amin(dim=1).numpy()
    parts = ("environment", "object", "self")  # in the kernel's order
    return geometry_reasons(depth, distance <= OUT_OF_REACH, parts=parts, limit=OBVIOUSLY_DEEP)


@dataclass(frozen=True)
class GenerationConfig:
    """What to generate for each object.

    non_prehensile, grasps: attempts per object and kind; 0 leaves a kind out. upright: share of the objects that stand on
    their end, those that can; the others lie.
    """

    hand: str = "shadow_lite"
    units: str = "m"
    length: float | None = None
    non_prehensile: int = 256
    grasps: int = 256
    upright: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ObjectOutcome:
    """What became of one object: its shard is written, or `failed` says why not.

    mesh_hash: see `mesh_hash`; counts: per behaviour; trace: where an error came from that nobody foresaw; repairs: what was
    repaired or assumed when the object was read, a sentence each.
    """

    mesh_hash: str = ""
    counts: dict[str, BehaviourCounts] = field(default_factory=dict)
    failed: str = ""
    trace: str = ""
    repairs: tuple[str, ...] = ()
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
            made = generate_object(
                self._hand,
                mesh,
                non_prehensile=self._config.non_prehensile,
                grasps=self._config.grasps,
                generator=np.random.default_rng(object_seed(self._manifest.seed, entry.name)),
                seed=self._manifest.seed,
                upright=stands(entry.name, self._config.upright),
            )
            manifest = replace(self._manifest, objects={entry.name: digest})
            write_shard(self._out, manifest, entry.name, made.rows, made.cloud, made.counts, made.turns)
        except OutputError:
            raise
        except DexnudgeError as error:
            return ObjectOutcome(failed=str(error), seconds=time.perf_counter() - start)
        except Exception as error:  # noqa: BLE001  one odd mesh among thousands must not end a run of hours
            failed = f"{type(error).__name__}: {error}"
            return ObjectOutcome(failed=failed, trace=traceback.format_exc(), seconds=time.perf_counter() - start)
        repairs = tuple(mesh.metadata.get("notes", ()))
        return ObjectOutcome(mesh_hash=digest, counts=made.counts, repairs=repairs, seconds=time.perf_counter() - start)


def mesh_hash(mesh: trimesh.Trimesh) -> str:
    """Return the SHA-256 of the vertices (float64, metres) and faces."""
    digest = hashlib.sha256(np.ascontiguousarray(mesh.vertices, dtype=np.float64).tobytes())
    digest.update(np.ascontiguousarray(mesh.faces, dtype=np.int64).tobytes())
    return digest.hexdigest()


def object_seed(seed: int, name: str) -> list[int]:
    """Return the entropy of one object's draws, which depends on the run's seed and the object's name alone."""
    return [seed, zlib.crc32(name.encode())]
