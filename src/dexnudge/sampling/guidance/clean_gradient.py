"""One gradient step on the clean estimate, without the network's derivative (MPGD, He et al., ICLR 2024).

    x0 = x0_hat - s g / |g|,   g = grad_{x0} L(x0_hat),   then DDIM from x0

`clean_descent` is this idea carried on: several steps on the hand's own manifold, with Adam moments.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.ddim import ddim_step
from dexnudge.sampling.guidance.gradient import gradient_at_clean_estimate, unit
from dexnudge.sampling.guidance.rule import ReverseStep


@dataclass(frozen=True)
class CleanGradient:
    """Strength s in the normalised space of x, the same in every step."""

    strength: float = 0.05

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """x_{t-1} from the corrected clean estimate."""
        with torch.no_grad():
            x0_hat = step.prior.predict_clean(step.x_t, step.t, step.condition, guidance_scale=step.guidance_scale)
        _, gradient = gradient_at_clean_estimate(step, x0_hat)
        corrected = x0_hat - self.strength * unit(gradient)
        return ddim_step(
            step.prior.schedule, step.x_t, corrected, step.t, step.t_previous, eta=step.eta, generator=step.generator
        )
