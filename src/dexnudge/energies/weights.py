"""Weights and clearances of the energy terms."""

from dataclasses import dataclass

from dexnudge.errors import InputError

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
