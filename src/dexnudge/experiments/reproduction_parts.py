"""The experiments that a reproduction consists of: which methods in which scenes, and what of that a run leaves out."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from dexnudge.errors import InputError, UnknownNameError
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.method_names import method_name
from dexnudge.sampling.methods import METHODS

STEERED_NOISE, RANDOM_START = "steered_noise", "random_start_projection"
MAIN = (STEERED_NOISE, RANDOM_START)  # what every main table shows: ours, and no prior at all
TABLES = (*MAIN, "guidance_only", "grasp_projection", "paper", "paper_guidance_only")  # Tables I and II compare these
RULES = ("best_of_32", "unguided_projection")  # choice without guidance, and neither
FURTHER = ("resampled", "coarse_hands", "clean_descent", "spherical", "clean_gradient", "unguided")
FROM_DATA = "nearest_pose"
QUICK_WITHOUT_BASE = (*MAIN, "guidance_only", "grasp_projection")
WITH_BASE, WITHOUT_BASE, GRASPS_ONLY = "with_base", "without_base", "grasps_only"
PREDICTIONS, HARD, GENERALISATION = "predictions", "hard", "generalisation"
PARTS = (WITH_BASE, WITHOUT_BASE, GRASPS_ONLY, PREDICTIONS, HARD, GENERALISATION)
QUICK_PARTS = (WITH_BASE, WITHOUT_BASE, GRASPS_ONLY, PREDICTIONS)
HARD_SCENES = ("slot", "deep", "corner", "clutter")
NEW_SCENES = ("drawer", "ramp", "stack")  # on which nothing was tuned
QUICK_NUM, FULL_NUM = 16, 32
QUICK_OBJECTS = 16  # about 25 s of one core for the rows of an object and its scenes: 4 minutes on two cores


@dataclass(frozen=True, kw_only=True)
class ReproductionConfig:
    """What is reproduced.

    Attributes:
        objects, max_objects, scenes, num, seed, units, length, weights, data: as in `ExperimentConfig`. `scenes` are
            those of all parts but `HARD` and `GENERALISATION`, which have their own. Without `data`, `nearest_pose` is
            left out, and the report says so.
        grasp_weights: folder of a model that was trained on grasps only; None leaves that part out.
        prediction_weights: name -> folder of a model; each is evaluated like `weights`. Empty leaves that part out.
        parts: names in `PARTS`; None for all, with `quick` for `QUICK_PARTS`.
        methods: only these of each part's; None for all.
        quick: fewer methods and parts.
    """

    objects: str = "builtin:test"
    max_objects: int | None = None
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    num: int = FULL_NUM
    seed: int = 0
    units: str = "m"
    length: float | None = None
    weights: str | None = None
    grasp_weights: str | None = None
    prediction_weights: dict[str, str] = field(default_factory=dict)
    data: str | None = None
    parts: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    quick: bool = False

    def as_json(self) -> dict[str, Any]:
        """Its fields as they are written into a run's folder."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> "ReproductionConfig":
        """The config that `as_json` wrote."""
        options: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in content.items()
        }
        return cls(**options)

    @property
    def named_parts(self) -> tuple[str, ...]:
        """The parts that this run is asked for, in the order of `PARTS`."""
        chosen = self.parts if self.parts is not None else QUICK_PARTS if self.quick else PARTS
        return tuple(part for part in PARTS if part in chosen)


@dataclass(frozen=True)
class Part:
    """One experiment of the run: the folder below the run's, a heading, and what is evaluated."""

    folder: str
    title: str
    config: ExperimentConfig


def parts(config: ReproductionConfig) -> list[Part]:
    """The experiments of a run, in the order in which they are worked on; those without a method are left out.

    Raises:
        UnknownNameError: no such part. InputError: a method that no part of this run has, or no part at all.
    """
    for name in config.named_parts if config.parts is None else config.parts:
        if name not in PARTS:
            raise UnknownNameError(f"unknown part {name!r}; expected some of {', '.join(PARTS)}")
    found = [part for part in _all_parts(config) if part.config.methods]
    offered = list(dict.fromkeys(method for part in _all_parts(config, every=True) for method in part.config.methods))
    for method in config.methods or ():
        if method not in offered:
            raise InputError(
                f"no part of this run has the method {method!r}; expected some of {', '.join(offered)}; "
                f"{FROM_DATA} needs --data"
            )
    if not found:
        raise InputError(
            f"nothing is left of the parts {', '.join(config.named_parts)}; expected a part that has what it needs: "
            f"{GRASPS_ONLY} needs --grasp-weights, {PREDICTIONS} needs --prediction-weights"
        )
    return found


def left_out(config: ReproductionConfig) -> list[str]:
    """Rows that this run does not have, and what they need."""
    named = config.named_parts
    why = "by --quick" if config.parts is None else "by --parts"
    missing = [f"part {part}: left out {why}" for part in PARTS if part not in named]
    if not config.data:
        missing.append(f"{method_name(FROM_DATA)}: needs a dataset, --data DIR")
    if GRASPS_ONLY in named and not config.grasp_weights:
        missing.append("a model trained on grasps only: needs its folder, --grasp-weights DIR")
    if PREDICTIONS in named and not config.prediction_weights:
        missing.append("other prediction types: need models, --prediction-weights NAME=DIR ...")
    had = {method for part in parts(config) for method in part.config.methods}
    why = "by --methods" if config.methods is not None else "by --quick" if config.quick else "by --parts"
    missing += [f"{method_name(each)}: left out {why}" for each in METHODS if each not in {*had, FROM_DATA}]
    return missing


def _all_parts(config: ReproductionConfig, *, every: bool = False) -> Iterator[Part]:
    """The parts that are asked for and have what they need; `every`: with all of their methods."""

    def part(folder: str, title: str, methods: tuple[str, ...], **changed: Any) -> Part:
        chosen = methods if every or config.methods is None else tuple(m for m in methods if m in config.methods)
        return Part(folder, title, _experiment(config, chosen, **changed))

    with_base = TABLES + RULES + (() if config.quick else FURTHER) + ((FROM_DATA,) if config.data else ())
    for name in config.named_parts:
        if name == WITH_BASE:
            yield part(name, "With the forearm", with_base, sweep=True)
        elif name == WITHOUT_BASE:
            yield part(name, "Without the forearm", QUICK_WITHOUT_BASE if config.quick else TABLES, base=False)
        elif name == GRASPS_ONLY and config.grasp_weights:
            yield part(name, "A model trained on grasps only", ("grasp_projection",), weights=config.grasp_weights)
        elif name == PREDICTIONS:
            for label, folder in config.prediction_weights.items():
                yield part(f"{PREDICTIONS}-{label}", f"Weights {label}", (STEERED_NOISE,), weights=folder)
        elif name == HARD:
            yield part(name, "Hard scenes", MAIN, scenes=HARD_SCENES)
        elif name == GENERALISATION:
            yield part(name, "Scenes on which nothing was tuned", MAIN, scenes=NEW_SCENES)


def _experiment(config: ReproductionConfig, methods: tuple[str, ...], **changed: Any) -> ExperimentConfig:
    options: dict[str, Any] = {
        "objects": config.objects,
        "max_objects": config.max_objects,
        "scenes": config.scenes,
        "methods": methods,
        "num": config.num,
        "seed": config.seed,
        "units": config.units,
        "length": config.length,
        "weights": config.weights,
        "data": config.data if FROM_DATA in methods else None,
    }
    return ExperimentConfig(**{**options, **changed})
