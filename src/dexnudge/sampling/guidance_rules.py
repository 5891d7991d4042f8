"""The rules of guidance: the paper's Eq. 5 as printed, on the sphere about DDIM's mean, and on the clean estimate itself.

On the sphere, noise is turned towards descent of the energy and its length is kept.

`SphericalGuidance` is DSG (Yang et al., ICML 2024), its gradient taken through the network. `CleanSpherical` takes the
gradient at the clean estimate, takes the mean of a solver of second order, and turns less where the energy is low and for
joint angles. `Resampled` adds sequential Monte Carlo: every few steps the draws of a call are weighed by
exp(-L / temperature), L the energy at their clean estimates; where the effective sample size falls below half of the draws,
they are drawn anew from the weights (systematic resampling), and the noise of later steps parts those that come from one.
Such draws of a call are not independent.
"""

import math
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.diffusion.schedule import ddim_mean_and_sigma, noise_like
from dexnudge.energies.descent import HandDescent, StepSizes, configuration_from_pose, pose_from_configuration
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.sampling.guidance import (
    SMALLEST_NORM,
    ReverseStep,
    gradient_at_clean_estimate,
    gradient_through_network,
    unit,
)


@dataclass(frozen=True)
class PaperGuidance:
    """Eq. 5 with strength s in the normalised space of x."""

    strength: float = 0.05

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1}, each sample guided by its own gradient's direction."""
        x0_hat, gradient = gradient_through_network(step)
        return step.ddim(x0_hat) - self.strength * unit(gradient)


@dataclass(frozen=True)
class SphericalGuidance:
    """DSG; `rate` in [0, 1]: 0 keeps the direction of the noise, 1 replaces it by that of steepest descent."""

    rate: float = 0.2

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} on the sphere about DDIM's mean."""
        x0_hat, gradient = gradient_through_network(step)
        return spherical_step(step, x0_hat, gradient, rate=self.rate)


def spherical_step(
    step: ReverseStep,
    x0_hat: Float[Tensor, "batch dimension"],
    gradient: Float[Tensor, "batch dimension"],
    *,
    rate: float | Float[Tensor, "batch dimension"],
) -> Float[Tensor, "batch dimension"]:
    """Return x_{t-1} on the sphere about DDIM's mean: noise turned towards -gradient by `rate`, each coordinate or all."""
    mean, sigma = ddim_mean_and_sigma(step.prior.schedule, step.x_t, x0_hat, step.t, step.t_previous, eta=1.0)
    radius = mean.shape[1] ** 0.5 * sigma
    noise = sigma * noise_like(mean, step.generator)
    slope = gradient.norm(dim=1, keepdim=True) > SMALLEST_NORM
    mixed = torch.where(slope, noise + rate * (-radius * unit(gradient) - noise), noise)
    return mean + radius * unit(mixed)


@dataclass
class CleanSpherical:
    """The default rule: noise steered by the gradient at the clean estimate. State of one run.

    The mean is that of SDE-DPM-Solver++(2M) (Lu et al., 2022): from the clean estimates of this step and of the last one,
    extrapolated to the middle of the step in half the logarithm of the signal-to-noise ratio. With the estimate of this step
    alone (DDPM), half as many steps leave draws that are more alike.

    rate: in [0, 1]; 0 keeps the noise, 1 replaces it where the energy is high. joints: share of that for joint angles.
    negligible: energy [m^2] at which half of it is left. begin: share of signal (alpha bar) from which on noise is steered;
    before, the estimate is an average over all modes and means nothing.
    """

    rate: float = 0.85
    joints: float = 0.5
    negligible: float = 8.0e-4
    begin: float = 0.02
    _last: tuple[float, Tensor] | None = field(default=None, init=False, repr=False)

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} on the sphere about the solver's mean."""
        x0_hat = step.clean_estimate()
        extrapolated = self._extrapolated(step, x0_hat)
        if step.alpha_bar < self.begin:
            return spherical_step(step, extrapolated, torch.zeros_like(x0_hat), rate=0.0)
        energy, gradient = gradient_at_clean_estimate(step, x0_hat)
        return spherical_step(step, extrapolated, gradient, rate=self.rates(energy, x0_hat.shape[1]))

    def _extrapolated(
        self, step: ReverseStep, x0_hat: Float[Tensor, "batch dimension"]
    ) -> Float[Tensor, "batch dimension"]:
        """Return the clean estimate in the middle of the step; in the first and the last one that of the step itself."""
        last, here = self._last, half_log_snr(step.alpha_bar)
        self._last = here, x0_hat
        if last is None or step.t_previous < 0:
            return x0_hat
        ahead = half_log_snr(float(step.prior.schedule.alphas_cumprod[step.t_previous])) - here
        return x0_hat + (0.5 * ahead / (here - last[0])) * (x0_hat - last[1])

    def rates(self, energy: Float[Tensor, " batch"], dimension: int) -> Float[Tensor, "batch dimension"]:
        """Return the rate of each sample and coordinate, for energies L [m^2]; 0 without energy."""
        share = torch.ones(dimension, dtype=energy.dtype, device=energy.device)
        share[ROOT_COORDINATES:] = self.joints
        steered = self.rate * energy / (energy + self.negligible).clamp_min(torch.finfo(energy.dtype).tiny)
        return steered[:, None] * share


def half_log_snr(alpha_bar: float) -> float:
    """Return 1/2 log(alpha_bar / (1 - alpha_bar)), finite without signal."""
    return 0.5 * math.log(max(alpha_bar, SMALLEST_NORM) / (1.0 - alpha_bar))


LEAST_WORTH = 0.5  # of the draws: effective sample size over their number from which nothing is resampled
LAST = 0.15  # of the training steps: later, noise no longer parts draws that come from one


@dataclass
class Resampled:
    """State of one run. temperature: of the weights [m^2]. every: steps between two resamplings."""

    steering: CleanSpherical = field(default_factory=CleanSpherical)
    temperature: float = 1.0e-2
    every: int = 5
    steps: int = field(default=0, init=False)

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} on the sphere about DDIM's mean."""
        x0_hat = step.clean_estimate()
        energy, gradient = gradient_at_clean_estimate(step, x0_hat)
        self.steps += 1
        if self.steps % self.every == 0 and step.t >= LAST * len(step.prior.schedule.alphas_cumprod):
            chosen = resampled(energy, temperature=self.temperature, generator=step.generator)
            step = replace(step, x_t=step.x_t[chosen])
            x0_hat, energy, gradient = x0_hat[chosen], energy[chosen], gradient[chosen]
        return spherical_step(step, x0_hat, gradient, rate=self.steering.rates(energy, x0_hat.shape[1]))


def resampled(
    energy: Float[Tensor, " batch"], *, temperature: float, generator: torch.Generator
) -> Int[Tensor, " batch"]:
    """Return which draws go on, ascending; each once where the weights are even enough."""
    weight, count = torch.softmax(-energy / temperature, dim=0), len(energy)
    if 1 / (weight**2).sum() >= LEAST_WORTH * count:
        return torch.arange(count, device=energy.device)
    start = torch.rand(1, generator=generator, device="cpu").to(energy.device)
    places = (start + torch.arange(count, device=energy.device)) / count
    return torch.searchsorted(weight.cumsum(0), places.to(weight.dtype)).clamp_max(count - 1)


@dataclass(frozen=True)
class CleanGradient:
    """Strength s in the normalised space of x, the same in every step."""

    strength: float = 0.05

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} from the corrected clean estimate."""
        x0_hat = step.clean_estimate()
        _, gradient = gradient_at_clean_estimate(step, x0_hat)
        return step.ddim(x0_hat - self.strength * unit(gradient))


@dataclass
class CleanDescent:
    """A few steps of descent on the clean estimate, with Adam moments that live through one denoising run.

    x0_hat is turned into a hand, the hand descends the scene's energy on its own manifold (translation, SO(3), joints within
    limits and couplings), and DDIM goes on from the corrected estimate. Nothing is differentiated through the network (as in
    MPGD and in TFG's mean guidance), the steps shrink where almost nothing is wrong, and their size does not depend on the
    other samples of the batch. The moments carry over from one denoising step to the next (as in Adam-guided sampling),
    because the gradients of consecutive steps stay correlated.

    inner_steps: of descent in each denoising step. begin: share of signal (alpha bar) from which on guidance acts; before,
    the estimate is an average over all modes and means nothing. negligible: energy [m^2] under which the steps shrink.
    """

    inner_steps: int = 6
    begin: float = 0.02
    negligible: float = 1.0e-4
    step_sizes: StepSizes = StepSizes(translation=0.008, rotation=0.06, joints=0.06)
    _descent: HandDescent | None = field(default=None, repr=False)

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} from the corrected clean estimate."""
        x0_hat = step.clean_estimate()
        return step.ddim(self._correct(step, x0_hat) if step.alpha_bar >= self.begin else x0_hat)

    def _correct(self, step: ReverseStep, x0_hat: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        q = step.prior.normaliser.denormalise(x0_hat)
        step.set_active_contacts(q)
        if self._descent is None:
            self._descent = HandDescent(step.hand, len(q), steps=self.step_sizes, tied=True, device=step.energy.device)
        pose = pose_from_configuration(q)
        for _ in range(self.inner_steps):
            energy = (step.energy(pose) + step.pull_to_balance())[:, None]
            # Adam alone would take full steps on a hand that is almost right.
            pose = self._descent.step(pose, step.energy.gradient, scale=(energy / (energy + self.negligible)).sqrt())
        return step.prior.normaliser.normalise(configuration_from_pose(pose))
