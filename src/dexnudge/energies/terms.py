"""Weights of the energy's terms; and terms of one's own, in torch, beside those of the fused kernel.

The kernel holds the terms that every scene needs (`TermWeights`): they are fast because they know the hand's grids and
points, and fixed because they are compiled. A term of one's own is any object that fits `EnergyTerm`. `HandEnergy` adds
both: energy and gradient of a hand are those of the kernel plus

    sum over terms of  weight * term(hands, scene)

so that whatever descends a `HandEnergy` feels both alike: every guidance rule, the choice among coarse hands, and the
projection. The kernel works in the scene's canonical frame; a term is given hands in the world. Its derivative comes from
torch, through the hand's kinematics. Without terms nothing of this file runs.

Energies are squared lengths [m^2] summed over points: 1 mm of penetration at 100 points is 1e-4. Choose a weight so that
what a term must not allow costs about as much.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.descent import HandPose, configuration_from_pose
from dexnudge.errors import InputError, UnknownNameError, check_kind, quote
from dexnudge.hands.batch import HandBatch
from dexnudge.hands.hand import Hand
from dexnudge.plugins import attribute, call_foreign, load_plugin, plugin_title
from dexnudge.scenes.scene import Scene

OUTSIDE_KERNEL = ("force", "limits")  # terms of those who know more than hand and scene
LARGEST_WEIGHT = 1e6  # of any term: single precision holds its square times that of any length


@dataclass(frozen=True)
class TermWeights:
    """Weights of the terms of the energy, and the distances [m] at which their hinges begin. A weight of 0 switches off.

    The penetration terms (`environment`, `object`, `self`) are those of Eq. 6, squared distances summed over points;
    `contact` is its unsigned object term, taken at the nearest point of each link that should touch; `target` is the first
    term of Eq. 1, for links that have a target. A clearance above zero keeps what lies between the guiding points clear as
    well.

    `sweep` counts the environment that the hand meets while it is carried along the motion, over and above what it meets
    where it stands, with the environment's clearance. `base` keeps the forearm at `clearance_base` from the environment.
    `force` [m^2] weighs half the squared residual of the force balance [weights of the object], `limits` [m^2/rad^2] the
    squared violation of joint limits and couplings; both are for those who hold the balance and the joint angles
    (`force_residual`, the guidance rules): the kernel knows nothing of them.

    Raises:
        InputError: a value that is negative, not finite, or so large that an energy would overflow.
    """

    environment: float = 1.0
    object: float = 1.0
    self: float = 1.0
    contact: float = 4.0
    target: float = 0.0
    sweep: float = 0.0
    base: float = 0.0
    force: float = 0.0
    limits: float = 0.0
    clearance_environment: float = 0.0010
    clearance_object: float = 0.0
    clearance_self: float = 0.0005
    clearance_base: float = 0.0
    contact_gap: float = 0.0005

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 <= value <= LARGEST_WEIGHT:
                what, off = (
                    ("distance", "")
                    if name.startswith(("clearance", "contact_gap"))
                    else ("weight", "; 0 switches it off")
                )
                raise InputError(
                    f"the {what} '{name}' of the energy is {value:g}; expected a number from 0 to {LARGEST_WEIGHT:g}{off}"
                )


BUILTIN_WEIGHTS = tuple(name for name in vars(TermWeights()) if not name.startswith(("clearance", "contact_gap")))
"""Names of the built-in terms, whose weights can be set."""


NO_GRADIENT = (
    "has no gradient in the configuration; expected torch operations on `hands.q`, `hands.T_world_link` or "
    "`hands.points`, without detach() or numpy"
)


@runtime_checkable
class EnergyTerm(Protocol):
    """A term of the energy; the smaller, the better a hand is.

    Attributes:
        name: what messages call it; no other term of the same sampler has it.
        weight: factor, above 0.
    """

    name: str
    weight: float

    def __call__(self, hands: HandBatch, scene: Scene) -> Float[Tensor, " batch"]:
        """Return the energy of each hand, by torch operations on `hands.q`, `.T_world_link` or `.points` (world frame).

        They lie on the sampler's device: tensors of your own have to, too, as those by `hands.q.new_tensor` do.

        The energy of a hand must depend on that hand alone: how many others stand in the batch changes from call to call.
        """


def check_terms(terms: Sequence[Any]) -> tuple[EnergyTerm, ...]:
    """Return the terms; what is wrong about them is found before anything is drawn.

    Raises:
        InputError: a name or a weight that makes no sense, no function, or two terms of one name.
    """
    if isinstance(terms, str) or not isinstance(terms, Iterable):
        given = type(terms).__name__
        raise InputError(f"`terms` is a {given}; expected a sequence of terms, such as [{given}()]")
    names: list[str] = []
    for place, term in enumerate(terms):
        if isinstance(term, type):
            raise InputError(
                f"entry {place} of `terms` is the class {term.__name__}; expected an object, such as {term.__name__}()"
            )
        kind = type(term).__name__
        name = attribute(f"term {place} of `terms`, a {kind},", term, "name")
        if not isinstance(name, str) or not name.strip():
            raise InputError(
                f"term {place} of `terms`, a {kind}, has the name {quote(name)}; expected a text; give it an attribute "
                "`name`"
            )
        if not callable(term):
            raise InputError(f"term '{name}', a {kind}, cannot be called; expected a method `__call__(hands, scene)`")
        _check_weight(name, attribute(f"term '{name}'", term, "weight"))
        if name in names:
            raise InputError(f"two terms are named '{name}'; expected a name of its own for each; rename one")
        names.append(name)
    return tuple(terms)


def find_term(name: str, *, weight: float | None = None) -> EnergyTerm:
    """Return the term that an installed package brings under a name, with its own weight unless one is given.

    Raises:
        UnknownNameError: no package brings it; the message lists those that exist.
        InputError: it cannot be imported or made, is no term, or the weight makes no sense.
    """
    if name in BUILTIN_WEIGHTS:
        raise UnknownNameError(
            f"energy term '{name}' is built in; expected one that a package brings; on the command line its weight is "
            f"`weight_{name}`"
        )
    check_kind("name", name, str, "that of an installed package's term")
    found = load_plugin("energy term", name)
    if weight is not None:
        _check_weight(name, weight)  # before anything that the package would be blamed for
    what = plugin_title("energy term", name)
    made = call_foreign(f"{what} cannot be made", _make_term, found, weight)
    try:
        return check_terms([made])[0]
    except InputError as error:
        raise InputError(f"{what}: {error}") from error


def _check_weight(name: str, weight: object) -> None:
    if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not 0 < weight <= LARGEST_WEIGHT:
        raise InputError(
            f"the weight of term '{name}' is {quote(weight)}; expected a finite number above 0, at most "
            f"{LARGEST_WEIGHT:g}; leave the term out to switch it off"
        )


def _make_term(found: Any, weight: float | None) -> Any:
    term = found() if isinstance(found, type) or not hasattr(found, "name") else copy(found)
    if weight is not None:
        object.__setattr__(term, "weight", weight)  # of frozen dataclasses, too
    return term


class TermEnergy:
    """The weighted sum of terms, in the frame in which hands descend.

    Args:
        terms: see `check_terms`.
        hand: what is configured.
        scene: handed to the terms.
        T_world_frame: the descending hands' frame in the world.
        device: where they descend.
    """

    def __init__(
        self,
        terms: Sequence[EnergyTerm],
        hand: Hand,
        scene: Scene,
        T_world_frame: Float[np.ndarray, "4 4"],
        *,
        device: str = "cpu",
    ) -> None:
        self.terms, self.hand, self.scene = check_terms(terms), hand, scene
        self._rotation = torch.as_tensor(T_world_frame[:3, :3], dtype=torch.float32, device=device)
        self._translation = torch.as_tensor(T_world_frame[:3, 3], dtype=torch.float32, device=device)

    def __call__(self, pose: HandPose) -> tuple[Float[Tensor, " batch"], Float[Tensor, "batch tangent"]]:
        """Return (energy, gradient in translation, rotation vector and joint angles), as `HandEnergy` has it.

        Raises:
            InputError: naming the term that fails, or whose energy or gradient is of no use.
        """
        with torch.inference_mode(mode=False), torch.enable_grad():
            q = configuration_from_pose(pose).detach().clone().requires_grad_()
            columns = q[:, 3:9].unflatten(1, (2, 3)) @ self._rotation.T
            position = q[:, :3] @ self._rotation.T + self._translation
            hands = HandBatch(self.hand, torch.cat([position, columns.flatten(1), q[:, 9:]], dim=1))
            total, gradient = q.new_zeros(len(q)), torch.zeros_like(q)
            for term in self.terms:
                value, slope = self._checked(term, hands, q)
                total += term.weight * value
                gradient += term.weight * slope
        # A column c of the rotation moves by w x c, so that g . (w x c) = w . (c x g).
        own, slopes = (each[:, 3:9].detach().unflatten(1, (2, 3)) for each in (q, gradient))
        turn = torch.linalg.cross(own, slopes).sum(dim=1)
        return total, torch.cat([gradient[:, :3], turn, gradient[:, 9:]], dim=1)

    def _checked(
        self, term: EnergyTerm, hands: HandBatch, q: Float[Tensor, "batch coordinates"]
    ) -> tuple[Float[Tensor, " batch"], Float[Tensor, "batch coordinates"]]:
        """(energy, its gradient in q) of one term."""
        what = f"energy term '{term.name}' failed"
        value = call_foreign(what, term, hands, self.scene)
        found = self._misfit(value, len(hands))
        slope: Tensor | None = None
        if found is None:  # backwards through its own code
            slope = call_foreign(what, torch.autograd.grad, value.sum(), q, retain_graph=True, allow_unused=True)[0]
        if found is None and slope is not None and not torch.isfinite(slope).all():
            found = (
                f"has a gradient that is NaN or infinite at {_rows(slope)} of {len(q)} hands; expected a finite one; a norm "
                "has none at 0, so take its square"
            )
        if slope is None or found is not None:
            raise InputError(f"energy term '{term.name}' {found or NO_GRADIENT}")
        return value.detach().to(q.dtype), slope

    def _misfit(self, value: object, batch: int) -> str | None:
        """What is wrong with what a term returned; None where nothing is."""
        if not isinstance(value, Tensor):
            return f"returned a {type(value).__name__}; expected a tensor of shape ({batch},)"
        if value.shape != (batch,):
            shape = tuple(value.shape)
            return f"returned shape {shape}; expected ({batch},), one energy for each hand; sum over the other axes"
        if not value.is_floating_point():
            return f"returned {value.dtype}; expected floating-point numbers, such as torch.float32"
        if not torch.isfinite(value).all():
            return f"is NaN or infinite at {_rows(value[:, None])} of {batch} hands; expected finite energies"
        return None if value.requires_grad else NO_GRADIENT


def _rows(values: Float[Tensor, "batch column"]) -> int:
    """How many rows hold NaN or infinity."""
    return int((~torch.isfinite(values)).any(dim=1).sum())
