"""Ours: the noise of each denoising step is turned towards steepest descent of the energy at the clean estimate.

    m = (1 - rate) sigma_t z - rate r g / |g|,   x_{t-1} = mu_t + r m / |m|,   r = sqrt(n) sigma_t,   g = grad_{x0_hat} L

with mu_t and sigma_t DDIM's mean and standard deviation at eta = 1 and n the dimension of x. As in spherical-Gaussian
guidance (DSG, see `spherical`) a sample stays where almost all of a Gaussian's mass is, and early steps, whose noise is
large, move a hand from one mode to another. But the gradient is taken at the clean estimate, without the derivative of the
network (as in MPGD): a third of the cost, and what counts is the scene's slope, not the network's.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.sampling.guidance.gradient import gradient_at_clean_estimate
from dexnudge.sampling.guidance.rule import ReverseStep
from dexnudge.sampling.guidance.spherical import spherical_step


@dataclass(frozen=True)
class CleanSpherical:
    """`rate` in [0, 1]: 0 keeps the direction of the noise, 1 replaces it by that of steepest descent."""

    rate: float = 0.6

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """x_{t-1} on the sphere about DDIM's mean."""
        with torch.inference_mode():
            x0_hat = step.prior.predict_clean(step.x_t, step.t, step.condition, guidance_scale=step.guidance_scale)
        x0_hat = x0_hat.clone()
        return spherical_step(step, x0_hat, gradient_at_clean_estimate(step, x0_hat), rate=self.rate)
