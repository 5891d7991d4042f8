"""Spherical-Gaussian guidance proper (DSG, Yang et al., 2024), which the paper's Eq. 5 shortens.

    d* = -r g / |g|,   d = sigma_t z,   m = d + rate (d* - d),   x_{t-1} = mu_t + r m / |m|,   r = sqrt(n) sigma_t

with mu_t and sigma_t DDIM's mean and standard deviation at eta = 1, g = grad_{x_t} L(x0_hat(x_t)) and n the dimension of
x. The sample stays where almost all of a Gaussian's mass is, on the sphere of radius r about the mean; at eta = 0 the radius
is zero and the rule does nothing, so it always samples at eta = 1. Here everything is per sample, and a sample without a
slope keeps its noise.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.ddim import ddim_mean_and_sigma
from dexnudge.sampling.guidance.gradient import SMALLEST_NORM, gradient_through_network, unit
from dexnudge.sampling.guidance.rule import ReverseStep


@dataclass(frozen=True)
class SphericalGuidance:
    """DSG; `rate` in [0, 1]: 0 keeps the direction of the noise, 1 replaces it by that of steepest descent."""

    rate: float = 0.2

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """x_{t-1} on the sphere about DDIM's mean."""
        x0_hat, gradient = gradient_through_network(step)
        return spherical_step(step, x0_hat, gradient, rate=self.rate)


def spherical_step(
    step: ReverseStep,
    x0_hat: Float[Tensor, "batch dimension"],
    gradient: Float[Tensor, "batch dimension"],
    *,
    rate: float | Float[Tensor, "batch dimension"],
) -> Float[Tensor, "batch dimension"]:
    """x_{t-1} on the sphere about DDIM's mean, from the noise towards -gradient by `rate`, of each coordinate or of all."""
    mean, sigma = ddim_mean_and_sigma(step.prior.schedule, step.x_t, x0_hat, step.t, step.t_previous, eta=1.0)
    radius = mean.shape[1] ** 0.5 * sigma
    noise = sigma * torch.randn(mean.shape, generator=step.generator, device=mean.device, dtype=mean.dtype)
    slope = gradient.norm(dim=1, keepdim=True) > SMALLEST_NORM
    mixed = torch.where(slope, noise + rate * (-radius * unit(gradient) - noise), noise)
    return mean + radius * unit(mixed)
