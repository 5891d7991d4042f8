"""Ours: the noise of each denoising step is turned towards steepest descent of the energy at the clean estimate.

    m = (1 - w) sigma_t z - w r g / |g|,   x_{t-1} = mu_t + r m / |m|,   r = sqrt(n) sigma_t,   g = grad_{x0_hat} L

with mu_t and sigma_t DDIM's mean and standard deviation at eta = 1 and n the dimension of x. As in spherical-Gaussian
guidance (DSG, see `spherical`) a sample stays where almost all of a Gaussian's mass is, and early steps, whose noise is
large, move a hand from one mode to another. But the gradient is taken at the clean estimate, without the derivative of the
network (as in MPGD): a third of the cost, and what counts is the scene's slope, not the network's.

w differs between samples and coordinates, so that steering costs no more variety than the scene asks for:

    w = rate L / (L + negligible) for the root,   joints times that for the joint angles

A hand that is almost right keeps its noise, and a hand gets out of the way by moving as a whole rather than by taking up the
one posture that every other sample takes up too.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.sampling.guidance.gradient import clean_estimate
from dexnudge.sampling.guidance.rule import ReverseStep
from dexnudge.sampling.guidance.spherical import spherical_step


@dataclass(frozen=True)
class CleanSpherical:
    """How much of the noise is replaced by steepest descent.

    rate: in [0, 1]; 0 keeps the noise, 1 replaces it where the energy is high. joints: share of that for joint angles.
    negligible: energy [m^2] at which half of it is left.
    """

    rate: float = 0.8
    joints: float = 0.5
    negligible: float = 1.0e-3

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """x_{t-1} on the sphere about DDIM's mean."""
        x0_hat, energy, gradient = clean_estimate(step)
        return spherical_step(step, x0_hat, gradient, rate=self.rates(energy, x0_hat.shape[1]))

    def rates(self, energy: Float[Tensor, " batch"], dimension: int) -> Float[Tensor, "batch dimension"]:
        """w of each sample and coordinate, for energies L [m^2]; one without energy has no slope either."""
        share = torch.ones(dimension, dtype=energy.dtype, device=energy.device)
        share[ROOT_COORDINATES:] = self.joints
        steered = self.rate * energy / (energy + self.negligible).clamp_min(torch.finfo(energy.dtype).tiny)
        return steered[:, None] * share
