"""What a guidance rule is given and returns."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.network import Condition
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.force_residual import ForceResidual
from dexnudge.hands.hand import Hand


@dataclass(frozen=True)
class ReverseStep:
    """One step of the reverse diffusion from t to t_previous.

    Attributes:
        energy: of the scene. force: the force balance of the same batch, weighed by the energy's weight `force`; None where
            it does not guide.
    """

    prior: DiffusionPrior
    condition: Condition
    hand: Hand
    energy: HandEnergy
    x_t: Float[Tensor, "batch dimension"]
    t: int
    t_previous: int
    guidance_scale: float
    eta: float
    generator: torch.Generator
    force: ForceResidual | None = None

    @property
    def alpha_bar(self) -> float:
        """Share of signal in x_t; 1 for clean data."""
        return float(self.prior.schedule.alphas_cumprod[self.t])


@runtime_checkable
class GuidanceRule(Protocol):
    """Turns x_t into x_{t-1} under the guidance of the energy."""

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """x at `step.t_previous`."""
