"""The schedule and its conversions against diffusers."""

import pytest
import torch
from diffusers import DDIMScheduler

from dexnudge.diffusion.config import Architecture, check_choice
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.errors import InputError, UnknownNameError

DIFFUSERS_NAMES = {"cosine": "squaredcos_cap_v2", "linear": "linear"}


def reference(name, **options):
    return DDIMScheduler(1000, beta_schedule=DIFFUSERS_NAMES[name], beta_start=1e-4, beta_end=0.02, **options)


@pytest.mark.parametrize("name", ["cosine", "linear"])
@pytest.mark.parametrize("zero_terminal_snr", [True, False])
def test_alphas_cumprod(name, zero_terminal_snr):
    schedule = NoiseSchedule(Architecture(schedule=name, zero_terminal_snr=zero_terminal_snr))
    expected = reference(name, rescale_betas_zero_snr=zero_terminal_snr).alphas_cumprod
    if zero_terminal_snr:
        # diffusers goes back and forth through float32 betas and leaves 2^-24 where the last value is to be zero
        assert float(schedule.alphas_cumprod[-1]) == 0.0
    torch.testing.assert_close(schedule.alphas_cumprod.float(), expected, atol=3e-6, rtol=1e-4)
    assert (schedule.alphas_cumprod.diff() < 0.0).all()


@pytest.mark.parametrize("num_inference_steps", [1, 4, 7, 10, 25, 1000])
def test_timesteps(num_inference_steps):
    scheduler = reference("cosine", timestep_spacing="trailing")
    scheduler.set_timesteps(num_inference_steps)
    assert NoiseSchedule(Architecture()).timesteps(num_inference_steps) == scheduler.timesteps.tolist()


def test_noise_and_velocity():
    generator = torch.Generator().manual_seed(0)
    x_0, epsilon = torch.randn(2, 40, 25, generator=generator)
    t = torch.randint(1000, (40,), generator=generator)
    schedule = NoiseSchedule(Architecture(prediction_type="v_prediction", zero_terminal_snr=False))
    scheduler = reference("cosine")
    torch.testing.assert_close(schedule.add_noise(x_0, epsilon, t), scheduler.add_noise(x_0, epsilon, t))
    torch.testing.assert_close(
        schedule.target(x_0, epsilon, t), scheduler.get_velocity(x_0, epsilon, t), atol=1e-5, rtol=1e-5
    )


@pytest.mark.parametrize("prediction_type", ["epsilon", "sample", "v_prediction"])
def test_the_true_target_gives_the_clean_data_back(prediction_type):
    generator = torch.Generator().manual_seed(0)
    x_0, epsilon = torch.randn(2, 40, 25, generator=generator)
    t = torch.randint(900, (40,), generator=generator)  # beyond, float32 leaves nothing of x_0 in epsilon's case
    schedule = NoiseSchedule(Architecture(prediction_type=prediction_type, zero_terminal_snr=False))
    x_t = schedule.add_noise(x_0, epsilon, t)
    found = schedule.clean_estimate(schedule.target(x_0, epsilon, t), x_t, t)
    torch.testing.assert_close(found, x_0, atol=1e-4, rtol=1e-4)


def test_clean_data_has_no_noise():
    assert float(NoiseSchedule(Architecture()).alpha_bar(torch.tensor(-1))) == 1.0


def test_impossible_requests():
    with pytest.raises(UnknownNameError, match="unknown noise schedule 'sigmoid'; expected one of cosine, linear"):
        check_choice("schedule", "sigmoid")
    with pytest.raises(
        UnknownNameError, match="unknown prediction type 'score'; expected one of epsilon, sample, v_pred"
    ):
        check_choice("prediction_type", "score")
    with pytest.raises(InputError, match="zero_terminal_snr cannot be used with epsilon prediction"):
        NoiseSchedule(Architecture(prediction_type="epsilon", zero_terminal_snr=True))
    with pytest.raises(InputError, match="num_inference_steps is 0, expected between 1 and 1000"):
        NoiseSchedule(Architecture()).timesteps(0)
