"""The weightings mean what they say, whatever the network predicts."""

import pytest
import torch

from dexnudge.diffusion.config import Architecture
from dexnudge.diffusion.objective import diffusion_loss, loss_weights
from dexnudge.diffusion.schedule import NoiseSchedule

T = torch.arange(20, 980, 20)


def loss_of_clean_error(prediction_type, weighting, error):
    """Loss of a network whose clean estimate is off by `error`, worked out through what it predicts."""
    schedule = NoiseSchedule(Architecture(prediction_type=prediction_type, zero_terminal_snr=False))
    generator = torch.Generator().manual_seed(0)
    x_0, epsilon = torch.randn(2, len(T), 5, generator=generator, dtype=torch.float64).float()
    x_t = schedule.add_noise(x_0, epsilon, T)
    alpha_bar = schedule.alpha_bar(T)[:, None]
    wrong_clean = x_0 + error
    wrong_epsilon = (x_t - alpha_bar.sqrt() * wrong_clean) / (1.0 - alpha_bar).sqrt()
    prediction = {
        "sample": wrong_clean,
        "epsilon": wrong_epsilon,
        "v_prediction": alpha_bar.sqrt() * wrong_epsilon - (1.0 - alpha_bar).sqrt() * wrong_clean,
    }[prediction_type]
    return diffusion_loss(
        prediction, schedule.target(x_0, epsilon, T), loss_weights(schedule, T, weighting, snr_limit=5.0)
    )


@pytest.mark.parametrize("weighting", ["min_snr", "velocity"])
def test_the_same_clean_error_costs_the_same_in_every_parametrisation(weighting):
    error = 0.1 * torch.randn(len(T), 5, generator=torch.Generator().manual_seed(1))
    costs = [loss_of_clean_error(kind, weighting, error) for kind in ("sample", "epsilon", "v_prediction")]
    torch.testing.assert_close(costs[1], costs[0], rtol=1e-3, atol=0.0)
    torch.testing.assert_close(costs[2], costs[0], rtol=1e-3, atol=0.0)


def test_uniform_epsilon_loss_is_equation_2():
    schedule = NoiseSchedule(Architecture(prediction_type="epsilon", zero_terminal_snr=False))
    epsilon, prediction = torch.randn(2, len(T), 5, generator=torch.Generator().manual_seed(0))
    loss = diffusion_loss(
        prediction, schedule.target(torch.zeros(len(T), 5), epsilon, T), loss_weights(schedule, T, "uniform", 5.0)
    )
    torch.testing.assert_close(loss, (epsilon - prediction).square().mean())


def test_weights_are_finite_where_nothing_but_noise_is_left():
    for kind in ("sample", "v_prediction"):
        schedule = NoiseSchedule(Architecture(prediction_type=kind))
        for weighting in ("uniform", "min_snr", "velocity"):
            assert loss_weights(schedule, torch.tensor([0, 999]), weighting, 5.0).isfinite().all()
