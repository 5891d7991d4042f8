"""One reverse step of DDIM (Song et al., 2021), deterministic or stochastic.

    x_{t-1} = sqrt(abar_{t-1}) x_0 + sqrt(1 - abar_{t-1} - sigma_t^2) epsilon + sigma_t z                   (their Eq. 12)
    sigma_t = eta sqrt((1 - abar_{t-1}) / (1 - abar_t)) sqrt(1 - abar_t / abar_{t-1})                       (their Eq. 16)

The paper's Eq. 3 prints only the first term; without the second the sample would keep no noise on its way.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.schedule import NoiseSchedule


def ddim_mean_and_sigma(
    schedule: NoiseSchedule,
    x_t: Float[Tensor, "batch dimension"],
    x0_hat: Float[Tensor, "batch dimension"],
    t: int,
    t_previous: int,
    *,
    eta: float = 0.0,
) -> tuple[Float[Tensor, "batch dimension"], float]:
    """Mean of x_{t-1} and the standard deviation sigma_t of the noise around it.

    x0_hat: the clean estimate, guided or not; epsilon is recomputed from it, so that x_t stays consistent with both.
    t_previous: the next timestep on the way down, -1 for clean data. eta: 0 deterministic, 1 as much noise as DDPM.
    """
    alpha_bar, alpha_bar_previous = (_alpha_bar(schedule, step) for step in (t, t_previous))
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
    """x_{t-1}; draws noise from `generator` when eta > 0."""
    mean, sigma = ddim_mean_and_sigma(schedule, x_t, x0_hat, t, t_previous, eta=eta)
    if sigma == 0.0:
        return mean
    noise = torch.randn(x_t.shape, generator=generator, device=x_t.device, dtype=x_t.dtype)
    return mean + sigma * noise


def _alpha_bar(schedule: NoiseSchedule, t: int) -> float:
    return 1.0 if t < 0 else float(schedule.alphas_cumprod[t])  # float64: 1 - abar_t / abar_{t-1} cancels
