"""The paper's rule, Eq. 5 as printed: x_{t-1} = DDIM(x_t) - s * g / |g|,  g = grad_{x_t} L(x0_hat(x_t)).

The gradient runs through the network. It is normalised per sample, so it pushes with full strength even where almost
nothing is wrong; with a deterministic sampler it is a heuristic, not the spherical-Gaussian guidance that it cites.
"""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from dexnudge.sampling.guidance.gradient import gradient_through_network, unit
from dexnudge.sampling.guidance.rule import ReverseStep


@dataclass(frozen=True)
class PaperGuidance:
    """Eq. 5 with strength s in the normalised space of x."""

    strength: float = 0.05

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1}, each sample guided by its own gradient's direction."""
        x0_hat, gradient = gradient_through_network(step)
        return step.ddim(x0_hat) - self.strength * unit(gradient)
