"""The paper's rule, Eq. 5 as printed: x_{t-1} = DDIM(x_t) - s * g / |g|,  g = grad_{x_t} L(x0_hat(x_t)).

The gradient runs through the network. It is normalised per sample, so it pushes with full strength even where almost
nothing is wrong; with a deterministic sampler it is a heuristic, not the spherical-Gaussian guidance that it cites.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.schedule import ddim_step
from dexnudge.sampling.guidance.gradient import gradient_through_network, unit
from dexnudge.sampling.guidance.rule import ReverseStep


def unguided(step: ReverseStep) -> Float[Tensor, "batch dimension"]:
    """x_{t-1} of the prior alone."""
    with torch.inference_mode():
        x0_hat = step.prior.predict_clean(step.x_t, step.t, step.condition, guidance_scale=step.guidance_scale)
        return ddim_step(
            step.prior.schedule, step.x_t, x0_hat, step.t, step.t_previous, eta=step.eta, generator=step.generator
        ).clone()


@dataclass(frozen=True)
class PaperGuidance:
    """Eq. 5 with strength s in the normalised space of x."""

    strength: float = 0.05

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """x_{t-1}, each sample guided by its own gradient's direction."""
        x0_hat, gradient = gradient_through_network(step)
        plain = ddim_step(
            step.prior.schedule, step.x_t, x0_hat, step.t, step.t_previous, eta=step.eta, generator=step.generator
        )
        return plain - self.strength * unit(gradient)
