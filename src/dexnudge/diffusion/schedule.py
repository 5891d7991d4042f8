"""The noise schedule, and one reverse step of DDIM (Song et al., 2021), deterministic or stochastic.

    x_{t-1} = sqrt(abar_{t-1}) x_0 + sqrt(1 - abar_{t-1} - sigma_t^2) epsilon + sigma_t z                   (their Eq. 12)
    sigma_t = eta sqrt((1 - abar_{t-1}) / (1 - abar_t)) sqrt(1 - abar_t / abar_{t-1})                       (their Eq. 16)

The paper's Eq. 3 prints only the first term; without the second the sample would keep no noise on its way.
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.diffusion.config import Architecture, ScheduleName
from dexnudge.errors import InputError

MAX_BETA = 0.999  # caps the cosine schedule's last steps, whose beta would reach 1 (Nichol and Dhariwal, 2021)
COSINE_OFFSET = 0.008  # keeps beta near t = 0 from vanishing (the same)
LINEAR_BETAS = (1e-4, 0.02)  # of 1000 steps (Ho et al., 2020)


def _betas(schedule: ScheduleName, num_train_timesteps: int) -> Float[Tensor, " step"]:
    if schedule == "linear":
        return torch.linspace(*LINEAR_BETAS, num_train_timesteps, dtype=torch.float64, device="cpu")
    time = torch.arange(num_train_timesteps + 1, dtype=torch.float64, device="cpu") / num_train_timesteps
    alphas_cumprod = torch.cos((time + COSINE_OFFSET) / (1.0 + COSINE_OFFSET) * math.pi / 2.0) ** 2
    return (1.0 - alphas_cumprod[1:] / alphas_cumprod[:-1]).clamp(max=MAX_BETA)


class NoiseSchedule:
    """abar_t for t = 0 .. T-1, decreasing, as `architecture` names it; abar_{-1} = 1 is clean data.

    cosine is diffusers' squaredcos_cap_v2. zero_terminal_snr shifts and scales sqrt(abar) so that the last step is pure
    noise (Lin et al., 2024).
    """

    def __init__(self, architecture: Architecture) -> None:
        self.prediction_type = architecture.prediction_type
        self.num_train_timesteps = architecture.num_train_timesteps
        self.alphas_cumprod = torch.cumprod(1.0 - _betas(architecture.schedule, self.num_train_timesteps), dim=0)
        if architecture.zero_terminal_snr:
            root = self.alphas_cumprod.sqrt()
            self.alphas_cumprod = ((root - root[-1]) * (root[0] / (root[0] - root[-1]))) ** 2
        self._padded = torch.cat([self.alphas_cumprod, torch.ones(1, dtype=torch.float64, device="cpu")]).float()

    def alpha_bar(self, t: Int[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Return abar_t, with abar_{-1} = 1."""
        return self._padded.to(t.device)[t]  # index -1 is the appended one

    def timesteps(self, num_inference_steps: int) -> list[int]:
        """Return descending timesteps from T-1 ('trailing' in diffusers): sampling begins where the noise is complete."""
        if not 1 <= num_inference_steps <= self.num_train_timesteps:
            raise InputError(
                f"num_inference_steps is {num_inference_steps}, expected between 1 and {self.num_train_timesteps}."
            )
        stride = self.num_train_timesteps / num_inference_steps
        return [round(self.num_train_timesteps - k * stride) - 1 for k in range(num_inference_steps)]

    def add_noise(
        self, x_0: Float[Tensor, "batch dimension"], epsilon: Float[Tensor, "batch dimension"], t: Int[Tensor, " batch"]
    ) -> Float[Tensor, "batch dimension"]:
        """Return x_t = sqrt(abar_t) x_0 + sqrt(1 - abar_t) epsilon."""
        alpha_bar = self.alpha_bar(t)[:, None]
        return alpha_bar.sqrt() * x_0 + (1.0 - alpha_bar).sqrt() * epsilon

    def target(
        self, x_0: Float[Tensor, "batch dimension"], epsilon: Float[Tensor, "batch dimension"], t: Int[Tensor, " batch"]
    ) -> Float[Tensor, "batch dimension"]:
        """Return what the network is trained to predict; v = sqrt(abar_t) epsilon - sqrt(1 - abar_t) x_0."""
        if self.prediction_type == "sample":
            return x_0
        if self.prediction_type == "epsilon":
            return epsilon
        alpha_bar = self.alpha_bar(t)[:, None]
        return alpha_bar.sqrt() * epsilon - (1.0 - alpha_bar).sqrt() * x_0

    def clean_estimate(
        self,
        prediction: Float[Tensor, "batch dimension"],
        x_t: Float[Tensor, "batch dimension"],
        t: Int[Tensor, " #batch"],
    ) -> Float[Tensor, "batch dimension"]:
        """Return the estimate of x_0 that `prediction` stands for (diffusers: pred_original_sample); differentiable."""
        if self.prediction_type == "sample":
            return prediction
        alpha_bar = self.alpha_bar(t)[:, None]
        if self.prediction_type == "epsilon":
            return (x_t - (1.0 - alpha_bar).sqrt() * prediction) / alpha_bar.sqrt()
        return alpha_bar.sqrt() * x_t - (1.0 - alpha_bar).sqrt() * prediction


def noise_like(
    x: Float[Tensor, "batch dimension"], generator: torch.Generator | None
) -> Float[Tensor, "batch dimension"]:
    """Return standard normal noise where x lies, drawn on the CPU: a seed gives the same noise on every device."""
    return torch.randn(x.shape, generator=generator, dtype=x.dtype, device="cpu").to(x.device)


def ddim_mean_and_sigma(
    schedule: NoiseSchedule,
    x_t: Float[Tensor, "batch dimension"],
    x0_hat: Float[Tensor, "batch dimension"],
    t: int,
    t_previous: int,
    *,
    eta: float = 0.0,
) -> tuple[Float[Tensor, "batch dimension"], float]:
    """Return the mean of x_{t-1} and the standard deviation sigma_t of the noise around it.

    x0_hat: the clean estimate, guided or not; epsilon is recomputed from it, so that x_t stays consistent with both.
    t_previous: the next timestep on the way down, -1 for clean data. eta: 0 deterministic, 1 as much noise as DDPM.
    """
    # float64: 1 - abar_t / abar_{t-1} cancels
    alpha_bar, alpha_bar_previous = (
        1.0 if step < 0 else float(schedule.alphas_cumprod[step]) for step in (t, t_previous)
    )
    variance = (1.0 - alpha_bar_previous) / (1.0 - alpha_bar) * (1.0 - alpha_bar / alpha_bar_previous)
    sigma = eta * variance**0.5
    epsilon = (x_t - alpha_bar**0.5 * x0_hat) / (1.0 - alpha_bar) ** 0.5
    direction = max(1.0 - alpha_bar_previous - sigma**2, 0.0) ** 0.5  # rounding may push it below 0 at eta = 1
    return alpha_bar_previous**0.5 * x0_hat + direction * epsilon, sigma


def ddim_step(
    schedule: NoiseSchedule,
    x_t: Float[Tensor, "batch dimension"],
    x0_hat: Float[Tensor, "batch dimension"],
    t: int,
    t_previous: int,
    *,
    eta: float = 0.0,
    generator: torch.Generator | None = None,
) -> Float[Tensor, "batch dimension"]:
    """Return x_{t-1}; draws noise from `generator` when eta > 0."""
    mean, sigma = ddim_mean_and_sigma(schedule, x_t, x0_hat, t, t_previous, eta=eta)
    if sigma == 0.0:
        return mean
    return mean + sigma * noise_like(x_t, generator)
