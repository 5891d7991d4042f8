"""Weights and clearances of the energy terms."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TermWeights:
    """Weights [1/m^2] of the squared distances in the energy, and where its hinges begin [m].

    The penetration terms are those of Eq. 6, summed over points; `contact` is its unsigned object term, taken at the
    nearest point of each link that should touch; `target` is the first term of Eq. 1. A clearance above zero keeps what
    lies between the guiding points clear as well.
    """

    environment: float = 1.0
    object: float = 1.0
    self: float = 1.0
    contact: float = 4.0
    target: float = 0.0
    clearance_environment: float = 0.0010
    clearance_object: float = 0.0
    clearance_self: float = 0.0005
    contact_gap: float = 0.0005
