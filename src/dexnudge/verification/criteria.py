"""The conditions of success, the built-in ones and those of one's own: objects that judge a batch of hands in a scene."""

from __future__ import annotations

import keyword
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from dexnudge.errors import InputError, check_kind, quote
from dexnudge.hands.batch import HandBatch
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.plugins import attribute, call_foreign, call_plugin, has_attribute, load_plugin, plugin_title
from dexnudge.scenes.scene import Scene
from dexnudge.verification.measurements import Measurements, measure

PENETRATION_LIMIT = 1e-3
"""Greatest depth of a successful configuration [m]."""
SUCCESS_MARGIN = 1.0
ROBUST_MARGIN = 1.5
"""Force margins from which a configuration succeeds, and is robust [-]."""
LIMITS_TOLERANCE = 1e-4
"""Violation of limits and couplings that single precision explains [rad of `Hand.joint_scales`]."""
ROTATION_TOLERANCE = 1e-4
"""Deviation of the 6D rotation's columns from unit length and right angle that single precision explains [-]."""
RESERVED = ("q", "joint_names", "success", "reasons", "contact_links")
"""Arrays of configurations.npz that belong to no criterion."""
FORESIGHT = ("probability", "share_of_worlds")
"""The same that need not be there."""
NUMPY_NAMES = ("file", "allow_pickle")
"""Names that numpy.savez cannot give to an array."""
AGREEMENT = 1e-4
"""What a value found again may differ by, relative to the larger of it and 1, unless a criterion says otherwise."""
BUILTIN_AGREEMENT = 1e-6
"""The same for the built-in criteria, which are deterministic: what another machine's rounding explains."""
MARGIN_AGREEMENT = 1e-3
"""The same for force margins, whose solver stops at a tolerance of its own [-]."""


@dataclass(frozen=True)
class CriterionResult:
    """What a criterion found about n hands.

    Attributes:
        value: (n,) numbers that are written and shown; NaN where there is nothing to measure.
        passed: (n,) bool.
        sentence: what a failure means and how to mend it; arguments in backticks, such as `num`.
    """

    value: np.ndarray | Tensor
    passed: np.ndarray | Tensor
    sentence: str = ""


@runtime_checkable
class Criterion(Protocol):
    """A condition that a configuration must meet to succeed.

    It may also have an attribute `tolerance`: what `check` allows its values to differ by when it finds them again,
    relative to the larger of the value and 1. One that has parameters has a method `save(folder, hand)`, which writes them
    into a folder of its own in each result, and a class method `load(folder)`, by which `check` makes it again.

    Attributes:
        name: an identifier; it names the array in configurations.npz and the reason of a rejection.
    """

    @property
    def name(self) -> str:
        """Name of the array in configurations.npz, and of the reason of a rejection."""

    def __call__(self, hands: HandBatch, scene: Scene) -> CriterionResult:
        """Judge each hand on its own.

        hands: at least one; their poses are valid, their `points` dense (2 mm), their numbers float64. `measure(hands,
        scene)` gives penetrations, contacts and force margins, shared with the built-in criteria.
        """


@dataclass(frozen=True)
class BuiltinCriterion:
    """A criterion that reads its value off the shared measurements.

    value_without_pose: of a configuration that is not finite or no rotation. tolerance: see `Criterion`. found: what stands
    at the head of the sentence, from the measurements.
    """

    name: str
    read: Callable[[HandBatch, Measurements], tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]]
    sentence: str
    value_without_pose: float = math.nan
    tolerance: float = BUILTIN_AGREEMENT
    found: Callable[[Measurements], str] | None = None

    def __call__(self, hands: HandBatch, scene: Scene) -> CriterionResult:
        """Judge each hand."""
        measurements = measure(hands, scene)
        value, passed = self.read(hands, measurements)
        return CriterionResult(value, passed, (self.found(measurements) if self.found else "") + self.sentence)


def limits_violation(hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> Float[np.ndarray, " n"]:
    """Return the greatest amount by which a joint is beyond a limit, or a follower beyond its leader; 0 if none.

    In [rad]; 0.05 m of a sliding joint count as one (`Hand.joint_scales`).
    """
    scales = hand.joint_scales.astype(q.dtype)
    angles, lower, upper = q[:, ROOT_COORDINATES:] / scales, hand.lower / scales, hand.upper / scales
    coupled = hand.coupled_indices
    excess = np.concatenate(
        [lower - angles, angles - upper, angles[:, coupled[:, 0]] - angles[:, coupled[:, 1]]], axis=1
    )
    return np.maximum(excess, 0.0).max(axis=1, initial=0.0)


def _rotation_error(hands: HandBatch, _: Measurements) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Deviation of the rotation's columns from unit length and right angle [-]; NaN where q is not finite."""
    q = hands.q.detach().cpu().numpy()
    finite = np.isfinite(q).all(axis=1)
    first, second = np.where(finite[:, None], q, 0.0)[:, 3:ROOT_COORDINATES].reshape(-1, 2, 3).swapaxes(0, 1)
    products = np.stack([(first * first).sum(1) - 1.0, (second * second).sum(1) - 1.0, (first * second).sum(1)])
    error = np.where(finite, np.abs(products).max(axis=0, initial=0.0), np.nan)
    return error, error <= ROTATION_TOLERANCE


def _joint_limits(hands: HandBatch, _: Measurements) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    violation = limits_violation(hands.hand, hands.q.detach().cpu().numpy())
    return violation, violation <= LIMITS_TOLERANCE


def _contact(_: HandBatch, found: Measurements) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    links = np.array([len(names) for names in found.contact_links], dtype=np.float64)
    return links, links > 0


def _motion_not_blocked(
    hands: HandBatch, found: Measurements
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """How much of the motion is free [m]; 0 where it runs into a support: the same for all hands."""
    return np.full(len(hands), found.free_way.length), np.full(len(hands), found.free_way.whole)


def _force_margin(_: HandBatch, found: Measurements) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Largest factor in [0, 3] on friction_environment at which forces balance; they must at the friction itself too.

    The two differ only where feasibility is not monotone in the friction, as for a hand that merely holds back an object
    on a ramp.
    """
    margin = found.margins.factor[:, 0]
    return margin, (margin >= SUCCESS_MARGIN) & found.margins.balanced[:, 0]


def _depth(_: HandBatch, found: Measurements, *, part: str) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    depth = getattr(found.penetrations, part)
    return depth, depth <= PENETRATION_LIMIT


VALID_POSE = BuiltinCriterion(
    "valid_pose",
    _rotation_error,
    "the configuration is not finite or its rotation is none; check the model that `weights` names",
)
_BUILTIN = (
    VALID_POSE,
    BuiltinCriterion(
        "joint_limits",
        _joint_limits,
        "the hand would have to bend beyond its limits; check the limits and couplings of `hand`",
    ),
    BuiltinCriterion(
        "penetration_environment",
        partial(_depth, part="environment"),
        "there is hardly room for the hand; make some, lower `clearance`, leave out the forearm (`base`), or draw more "
        "(`num`)",
    ),
    BuiltinCriterion(
        "penetration_object",
        partial(_depth, part="object"),
        "the hand cannot close in without entering the object; draw more (`num`)",
    ),
    BuiltinCriterion(
        "penetration_self",
        partial(_depth, part="self_collision"),
        "the fingers get into each other's way; draw more (`num`)",
    ),
    BuiltinCriterion(
        "contact",
        _contact,
        "the hand does not reach the object; check that something of it is exposed",
        value_without_pose=0.0,
    ),
    BuiltinCriterion(
        "motion_not_blocked",
        _motion_not_blocked,
        ", and no hand can help it; choose another `motion` or a shorter `motion_length`, or mend the `object_pose`",
        found=lambda found: f"the object is {found.free_way}",  # "blocked after 41 mm by something 6 mm high at (…) m"
    ),
    BuiltinCriterion(
        "force_margin",
        _force_margin,
        "contacts were found, but no forces that move the object; raise `friction_hand` or `max_normal_force`, lower "
        "`friction_environment` or `mass`, or draw more (`num`)",
        value_without_pose=0.0,
        tolerance=MARGIN_AGREEMENT,
    ),
)


def default_criteria() -> list[Criterion]:
    """Return the built-in criteria in the order in which a configuration is judged."""
    return list(_BUILTIN)


def missing_criteria(names: Iterable[str]) -> list[str]:
    """Return the built-in criteria that are not among `names`."""
    given = set(names)
    return [criterion.name for criterion in _BUILTIN if criterion.name not in given]


def find_criterion(name: str) -> Criterion:
    """Return the built-in criterion of that name, or the one that an installed package brings.

    Raises:
        UnknownNameError: there is none; the message lists those that exist.
        InputError: the package's criterion cannot be imported or is none.
    """
    check_kind("name", name, str, "'contact'")
    for criterion in _BUILTIN:
        if criterion.name == name:
            return criterion
    found = load_plugin("criterion", name, known=tuple(criterion.name for criterion in _BUILTIN))
    what = plugin_title("criterion", name)
    if isinstance(found, type) or not has_attribute(what, found, "name"):  # a class or a function that makes one
        found = call_plugin("criterion", name, Criterion)
    try:
        check_criteria([found])
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    if found.name != name:
        raise InputError(f"{what} is named '{found.name}'; expected its entry point's name; rename one")
    return found


def named_criteria(names: Iterable[str]) -> list[Criterion]:
    """Return the built-in criteria, which always hold, and after them those of these names that packages bring.

    Raises:
        UnknownNameError, InputError: as `find_criterion`.
    """
    return [*_BUILTIN, *(find_criterion(name) for name in names if name not in {each.name for each in _BUILTIN})]


def check_criteria(criteria: Iterable[Any] | None) -> list[Criterion]:
    """Return the criteria to judge by, `valid_pose` first: without a pose there is nothing to judge.

    Raises:
        InputError: something that is no criterion, a name that is taken or no identifier, or a tolerance that is none.
    """
    if criteria is None:
        return default_criteria()
    if isinstance(criteria, str) or not isinstance(criteria, Iterable):
        given = type(criteria).__name__
        own = given if callable(criteria) else "MyCriterion"
        raise InputError(f"`criteria` is a {given}; expected a sequence: [*default_criteria(), {own}()]")
    criteria = list(criteria)
    builtin = {criterion.name: criterion for criterion in _BUILTIN}
    names: set[str] = set()
    for place, criterion in enumerate(criteria):
        name = attribute(f"a {type(criterion).__name__}", criterion, "name")
        if isinstance(criterion, type) or not callable(criterion) or name is None:
            raise InputError(
                f"entry {place} of `criteria` is {quote(criterion)}; expected an object with a `name` that is called with "
                "(hands, scene), such as MyCriterion()"
            )
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
            raise InputError(
                f"criterion {quote(name)} has no usable name; expected an identifier such as 'manipulability': letters, "
                "digits and underscores"
            )
        if (
            name in (*RESERVED, *FORESIGHT, *NUMPY_NAMES)
            or name in names
            or builtin.get(name, criterion) is not criterion
        ):
            raise InputError(f"the name of criterion '{name}' is taken; expected one of its own; rename it")
        tolerance = attribute(f"criterion '{name}'", criterion, "tolerance", AGREEMENT)
        number = isinstance(tolerance, int | float | np.integer | np.floating) and not isinstance(tolerance, bool)
        if not number or not 0 <= tolerance < math.inf:
            raise InputError(
                f"the `tolerance` of criterion '{name}' is {quote(tolerance)}; expected a finite number, 0 or more; leave "
                f"it out for {AGREEMENT:g}"
            )
        names.add(name)
    return [VALID_POSE, *(criterion for criterion in criteria if criterion is not VALID_POSE)]


def _seen(hands: HandBatch, scene: Scene) -> list[object]:
    """Return what tells whether a criterion has changed in place what others see, too."""
    tensors = [each.detach().cpu().numpy().tobytes() for each in (hands.q, hands.T_world_link)]
    meshes = [hash(mesh) for mesh in (scene.object_mesh, scene.environment_mesh)]
    return [*tensors, *meshes, scene.T_world_object.tobytes(), scene.motion.tobytes()]


def judge(criterion: Criterion, hands: HandBatch, scene: Scene) -> tuple[np.ndarray, np.ndarray, str]:
    """Return (value (n,) float64, passed (n,) bool, sentence) of one criterion.

    Raises:
        InputError: it raises, or what it returns does not fit; the message names it.
    """
    if isinstance(criterion, BuiltinCriterion):
        own = criterion(hands, scene)
        return np.asarray(own.value), np.asarray(own.passed), own.sentence
    before = _seen(hands, scene)
    result = call_foreign(f"criterion '{criterion.name}' failed", criterion, hands, scene)
    if _seen(hands, scene) != before:
        raise InputError(
            f"criterion '{criterion.name}' changed the hands or the scene that it was given; expected it to leave them as "
            "they are, for others judge them, too; have it work on copies"
        )
    if not isinstance(result, CriterionResult):
        raise InputError(
            f"criterion '{criterion.name}' returned a {type(result).__name__}; expected "
            "CriterionResult(value=…, passed=…, sentence=…)"
        )
    arrays = {}
    for label, kinds, wanted in (("value", "fiub", "real numbers"), ("passed", "b", "bool")):
        what = f"criterion '{criterion.name}' returned a {label} that is no array"
        array = call_foreign(what, _array, result, label, mend=f"; expected {wanted} of shape ({len(hands)},)")
        if array.shape != (len(hands),) or array.dtype.kind not in kinds:
            raise InputError(
                f"criterion '{criterion.name}' returned {label} as {array.dtype} of shape {array.shape} for {len(hands)} "
                f"hands; expected {wanted} of shape ({len(hands)},)"
            )
        arrays[label] = array
    sentence = call_foreign(f"criterion '{criterion.name}' returned a sentence that is no text", _sentence, result)
    return arrays["value"].astype(np.float64), arrays["passed"], sentence


def _array(result: CriterionResult, label: str) -> np.ndarray:
    given = getattr(result, label)
    return given.detach().cpu().numpy() if isinstance(given, torch.Tensor) else np.asarray(given)


def _sentence(result: CriterionResult) -> str:
    return str(result.sentence)
