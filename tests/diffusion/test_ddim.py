"""The DDIM step against diffusers, and a whole sampler against a Gaussian whose posterior is known."""

import numpy as np
import pytest
import torch
from diffusers import DDIMScheduler

from dexnudge.diffusion.config import Architecture
from dexnudge.diffusion.schedule import NoiseSchedule, ddim_mean_and_sigma, ddim_step


@pytest.mark.parametrize("prediction_type", ["epsilon", "sample", "v_prediction"])
@pytest.mark.parametrize("eta", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("name", ["linear", "cosine"])
def test_every_step_equals_diffusers(prediction_type, eta, name):
    scheduler = DDIMScheduler(
        1000,
        beta_schedule={"linear": "linear", "cosine": "squaredcos_cap_v2"}[name],
        beta_start=1e-4,
        beta_end=0.02,
        prediction_type=prediction_type,
        timestep_spacing="trailing",
        clip_sample=False,
    )
    scheduler.set_timesteps(10)
    schedule = NoiseSchedule(Architecture(schedule=name, prediction_type=prediction_type, zero_terminal_snr=False))
    # Both in float64, so that only the formulas are compared: x_0 from epsilon cancels at the noisiest steps.
    scheduler.alphas_cumprod = schedule.alphas_cumprod
    schedule._padded = torch.cat([schedule.alphas_cumprod, torch.ones(1, dtype=torch.float64)])
    generator = torch.Generator().manual_seed(0)
    timesteps = schedule.timesteps(10)
    for t, t_previous in zip(timesteps, [*timesteps[1:], -1], strict=True):
        x_t, prediction, noise = torch.randn(3, 8, 25, generator=generator, dtype=torch.float64)
        expected = scheduler.step(prediction, t, x_t, eta=eta, variance_noise=noise if eta else None)
        x0_hat = schedule.clean_estimate(prediction, x_t, torch.tensor([t]))
        torch.testing.assert_close(x0_hat, expected.pred_original_sample, atol=1e-9, rtol=1e-9)
        mean, sigma = ddim_mean_and_sigma(schedule, x_t, x0_hat, t, t_previous, eta=eta)
        torch.testing.assert_close(mean + sigma * noise, expected.prev_sample, atol=1e-9, rtol=1e-9)


def test_noise_comes_from_the_generator_and_only_when_asked_for():
    schedule = NoiseSchedule(Architecture())
    x_t, x0_hat = torch.randn(2, 4, 3, generator=torch.Generator().manual_seed(0))
    draws = [
        ddim_step(schedule, x_t, x0_hat, 500, 400, eta=1.0, generator=torch.Generator().manual_seed(k))
        for k in (1, 1, 2)
    ]
    assert torch.equal(draws[0], draws[1])
    assert not torch.equal(draws[0], draws[2])
    mean, sigma = ddim_mean_and_sigma(schedule, x_t, x0_hat, 500, 400, eta=1.0)
    noise = torch.randn(4, 3, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(draws[0], mean + sigma * noise)
    assert torch.equal(ddim_step(schedule, x_t, x0_hat, 500, 400), ddim_step(schedule, x_t, x0_hat, 500, 400))


def test_the_last_step_returns_the_clean_estimate():
    x_t, x0_hat = torch.randn(2, 4, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(ddim_step(NoiseSchedule(Architecture()), x_t, x0_hat, 99, -1, eta=1.0), x0_hat)


@pytest.mark.parametrize("eta", [0.0, 1.0])
@pytest.mark.parametrize("prediction_type", ["sample", "v_prediction"])
def test_the_exact_denoiser_of_a_gaussian_samples_that_gaussian(eta, prediction_type):
    rng = np.random.default_rng(0)
    mean = torch.tensor([1.0, -2.0, 0.5])
    factor = torch.tensor(rng.normal(size=(3, 3)), dtype=torch.float32)
    covariance = factor @ factor.T + 0.05 * torch.eye(3)
    schedule = NoiseSchedule(Architecture(prediction_type=prediction_type))
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(20_000, 3, generator=generator)
    timesteps = schedule.timesteps(250)
    for t, t_previous in zip(timesteps, [*timesteps[1:], -1], strict=True):
        alpha_bar = schedule.alpha_bar(torch.tensor(t))
        # E[x_0 | x_t] for x_t = sqrt(abar) x_0 + sqrt(1 - abar) epsilon, by conditioning of jointly Gaussian vectors
        marginal = alpha_bar * covariance + (1.0 - alpha_bar) * torch.eye(3)
        gain = alpha_bar.sqrt() * covariance @ torch.linalg.inv(marginal)
        x0_hat = mean + (x - alpha_bar.sqrt() * mean) @ gain.T
        x = ddim_step(schedule, x, x0_hat, t, t_previous, eta=eta, generator=generator)
    torch.testing.assert_close(x.mean(dim=0), mean, atol=0.05, rtol=0.0)
    torch.testing.assert_close(torch.cov(x.T), covariance, atol=0.12, rtol=0.06)
