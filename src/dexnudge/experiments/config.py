"""What an experiment evaluates, and the trials that it consists of."""

import zlib
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple

from dexnudge.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from dexnudge.energies.terms import EnergyTerm
    from dexnudge.scenes.uncertainty import Uncertainty
    from dexnudge.verification.criteria import Criterion


@dataclass(frozen=True, kw_only=True)
class ExperimentConfig:
    """What is evaluated; two runs with equal configs and versions give the same records.

    Attributes:
        objects: a set as in `resolve_object_set`.
        max_objects: take this many of the set, evenly spaced in its order; None for all.
        scenes: names of scene families.
        methods: names of sampling methods.
        num: draws of each trial.
        seed: seed of the whole experiment; `trial_seed` derives that of a trial.
        units: of mesh files, unless the set implies a scale.
        length: longest side of every object [m], or None for the size that the set implies.
        hand: built-in name or URDF file.
        base: whether the forearm counts as part of the hand.
        physics: parameters of `build_scene` that differ from the defaults, turns among them.
        weights: folder of the model; None for that beside the hand's description, else the shipped one.
        data: dataset folder, for methods that start from stored poses.
        device: where sampling runs.
        losses: weights and clearances that differ from each method's own, by their names in `TermWeights`.
        terms: energy terms of installed packages with their weights, None for a term's own.
        criteria: further conditions of success, by name, from installed packages.
        uncertain: by how much frictions, mass and pose may be off, as words of `Uncertainty.parse`.
        sweep: whether draws are verified again at other frictions and masses, see `disturbances.VERIFIED_AT`.
    """

    objects: str
    max_objects: int | None = None
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    methods: tuple[str, ...] = ("steered_noise",)
    num: int = 32
    seed: int = 0
    units: str = "m"
    length: float | None = None
    hand: str = "shadow_lite"
    base: bool = True
    physics: dict[str, Any] | None = None
    weights: str | None = None
    data: str | None = None
    device: str = "cpu"
    losses: dict[str, float] | None = None
    terms: dict[str, float | None] | None = None
    criteria: tuple[str, ...] = ()
    uncertain: tuple[str, ...] = ()
    sweep: bool = False


MOST_VIEWS = 12
LARGEST = {"noise_mm": 10.0, "tilt_deg": 30.0, "pose_mm": 50.0, "pose_deg": 45.0, "triangle_mm": 200.0}
OF_MESHES = ("noise_mm", "triangle_mm", "rounding_mm")  # of scans that depth images do not stand for


@dataclass(frozen=True, kw_only=True)
class ScanErrors:
    """By how much a scanned world differs from the true one.

    Attributes:
        noise_mm: standard deviation of the scanned vertices along their normals [mm].
        tilt_deg: tilt of the true world about a random horizontal axis [deg].
        pose_mm: distance by which the given pose of the object is off, in a random direction [mm].
        pose_deg: angle by which it is turned about a random axis through its centre [deg].
        triangle_mm: edge of the scanned triangles, about [mm]; 0 for the scene's own triangles.
        rounding_mm: to which scanned vertices are rounded [mm].
        depth_views: so many depth images are rendered in place of a scanned mesh. Their camera has its own noise, so
            noise, triangles and rounding mean nothing then.

    Raises:
        InputError: a number that is negative or too large.
    """

    noise_mm: float = 0.0
    tilt_deg: float = 0.0
    pose_mm: float = 0.0
    pose_deg: float = 0.0
    triangle_mm: float = 8.0
    rounding_mm: float = 0.01
    depth_views: int = 0

    def __post_init__(self) -> None:
        for each in fields(self):
            value, most = getattr(self, each.name), LARGEST.get(each.name, MOST_VIEWS)
            if not 0 <= value <= most:
                raise InputError(f"`{each.name}` is {value:g}; expected 0 to {most:g}")
            if self.depth_views and each.name in OF_MESHES and value != each.default:
                raise InputError(
                    f"`{each.name}` does nothing with `depth_views`, whose camera has its own noise; expected one of them; "
                    f"leave `{each.name}` out"
                )


class TrialKey(NamedTuple):
    """What identifies a trial within an experiment."""

    object: str
    scene: str
    method: str


def trial_keys(config: ExperimentConfig) -> list[TrialKey]:
    """Return every trial of an experiment; those of one object and scene stand together.

    Raises:
        InputError: a name, count, device, loss or number of the scenes in the config is not valid.
        MeshError: the set of objects cannot be found.
    """
    from dexnudge.geometry.devices import check_device
    from dexnudge.sampling.methods import METHODS, find_method
    from dexnudge.scenes.families import scene_families
    from dexnudge.scenes.motion import check_asked
    from dexnudge.scenes.scene import check_physics

    for name, count in (("num", config.num), ("max_objects", config.max_objects)):
        if count is not None and count < 1:
            raise InputError(f"`{name}` is {count}; expected at least 1")
    scenes = scene_families()
    for what, names, known in (("scene", config.scenes, scenes), ("method", config.methods, tuple(METHODS))):
        if not names:
            raise InputError(f"no {what} is named; expected some of {', '.join(known)}")
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(f"the {what} {twice[0]!r} is named twice; expected each once")
    if unknown := [scene for scene in config.scenes if scene not in scenes]:
        raise UnknownNameError(f"unknown scene {unknown[0]!r}; expected some of {', '.join(scenes)}")
    asked = dict(config.physics or {})
    check_asked(**{name: asked.pop(name, None) for name in ("turn_deg", "tip_deg", "about")})
    check_physics(asked)
    for method in config.methods:
        find_method(method).with_weights(config.losses or {})  # refuses what makes no sense
    if config.data is not None and all(find_method(method).start != "nearest" for method in config.methods):
        raise InputError(
            "`data` is given without the method nearest_pose, which alone uses it; expected both; add nearest_pose to "
            "`methods`, or leave it out"
        )
    brought(config)
    check_device(config.device)
    return [
        TrialKey(name, scene, method)
        for name in _object_names(config)
        for scene in config.scenes
        for method in config.methods
    ]


def brought(config: ExperimentConfig) -> "tuple[list[EnergyTerm], list[Criterion], Uncertainty | None]":
    """Return the energy terms, the conditions of success, default ones among these, and the uncertainty of a config.

    Raises:
        InputError: a name that no installed package brings, or words that make no sense.
    """
    from dexnudge.energies.terms import find_term
    from dexnudge.scenes.uncertainty import Uncertainty
    from dexnudge.verification.criteria import named_criteria

    terms = [find_term(name, weight=weight) for name, weight in (config.terms or {}).items()]
    return terms, named_criteria(config.criteria), Uncertainty.parse(config.uncertain) if config.uncertain else None


def trial_seed(seed: int, key: TrialKey) -> int:
    """Return the seed of a trial's scene and draws: the same for all methods, so that they meet the same scenes."""
    import numpy as np  # options of commands stand in this module, and their help shall not wait for it

    parts = [seed, zlib.crc32(key.object.encode()), zlib.crc32(key.scene.encode())]
    return int(np.random.SeedSequence(parts).generate_state(1)[0])


def _object_names(config: ExperimentConfig) -> list[str]:
    from dexnudge.objects.sets import resolve_object_set

    names = [entry.name for entry in resolve_object_set(config.objects, units=config.units, length=config.length)]
    if config.max_objects is None or config.max_objects >= len(names):
        return names
    return [names[index * len(names) // config.max_objects] for index in range(config.max_objects)]
