"""The noise schedule of the forward process and the three quantities a network may predict.

    x_t = sqrt(abar_t) x_0 + sqrt(1 - abar_t) epsilon

The paper prints q_t = q_0 + epsilon (Sec. III-B) and then uses alpha_t as diffusers' alphas_cumprod in Eq. 3; this is
the scaled process that Eq. 3 needs. With epsilon as prediction the training loss is Eq. 2.
"""

import math
from collections.abc import Callable
from typing import Literal, get_args

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.errors import InputError, UnknownNameError

PredictionType = Literal["epsilon", "sample", "v_prediction"]
ScheduleName = Literal["cosine", "linear"]
MAX_BETA = 0.999  # caps the cosine schedule's last steps, whose beta would reach 1 (Nichol and Dhariwal, 2021)
COSINE_OFFSET = 0.008  # keeps beta near t = 0 from vanishing (the same)
LINEAR_BETAS = (1e-4, 0.02)  # of 1000 steps (Ho et al., 2020)


def _cosine_betas(num_train_timesteps: int) -> Float[Tensor, " step"]:
    time = torch.arange(num_train_timesteps + 1, dtype=torch.float64) / num_train_timesteps
    alphas_cumprod = torch.cos((time + COSINE_OFFSET) / (1.0 + COSINE_OFFSET) * math.pi / 2.0) ** 2
    return (1.0 - alphas_cumprod[1:] / alphas_cumprod[:-1]).clamp(max=MAX_BETA)


def _linear_betas(num_train_timesteps: int) -> Float[Tensor, " step"]:
    return torch.linspace(*LINEAR_BETAS, num_train_timesteps, dtype=torch.float64)


SCHEDULES: dict[str, Callable[[int], Tensor]] = {"cosine": _cosine_betas, "linear": _linear_betas}


class NoiseSchedule:
    """abar_t for t = 0 .. T-1, decreasing; abar_{-1} = 1 is clean data.

    name: `cosine` (diffusers' squaredcos_cap_v2) or `linear`. zero_terminal_snr: shift and scale sqrt(abar) so that the
    last step is pure noise (Lin et al., 2024); impossible for epsilon prediction, whose x_0 would be undefined there.
    """

    def __init__(
        self,
        name: str = "cosine",
        *,
        num_train_timesteps: int = 1000,
        prediction_type: str = "sample",
        zero_terminal_snr: bool = True,
    ) -> None:
        if name not in SCHEDULES:
            raise UnknownNameError(f"unknown noise schedule {name!r}; expected one of {', '.join(SCHEDULES)}.")
        if prediction_type not in get_args(PredictionType):
            raise UnknownNameError(
                f"unknown prediction type {prediction_type!r}; expected one of {', '.join(get_args(PredictionType))}."
            )
        if zero_terminal_snr and prediction_type == "epsilon":
            raise InputError(
                "zero_terminal_snr cannot be used with epsilon prediction: x_0 is undefined where x_t is pure noise; "
                "set zero_terminal_snr=False or predict 'sample' or 'v_prediction'."
            )
        alphas_cumprod = torch.cumprod(1.0 - SCHEDULES[name](num_train_timesteps), dim=0)
        if zero_terminal_snr:
            root = alphas_cumprod.sqrt()
            alphas_cumprod = ((root - root[-1]) * (root[0] / (root[0] - root[-1]))) ** 2
        self.name = name
        self.prediction_type = prediction_type
        self.num_train_timesteps = num_train_timesteps
        self.alphas_cumprod = alphas_cumprod
        self._padded = torch.cat([alphas_cumprod, torch.ones(1, dtype=torch.float64)]).float()

    def alpha_bar(self, t: Int[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """abar_t, with abar_{-1} = 1."""
        return self._padded.to(t.device)[t]  # index -1 is the appended one

    def timesteps(self, num_inference_steps: int) -> list[int]:
        """Descending, starting at T-1 ('trailing' in diffusers), so that sampling begins where the noise is complete."""
        if not 1 <= num_inference_steps <= self.num_train_timesteps:
            raise InputError(
                f"num_inference_steps is {num_inference_steps}, expected between 1 and {self.num_train_timesteps}."
            )
        stride = self.num_train_timesteps / num_inference_steps
        return [round(self.num_train_timesteps - k * stride) - 1 for k in range(num_inference_steps)]

    def add_noise(
        self, x_0: Float[Tensor, "batch dimension"], epsilon: Float[Tensor, "batch dimension"], t: Int[Tensor, " batch"]
    ) -> Float[Tensor, "batch dimension"]:
        """x_t = sqrt(abar_t) x_0 + sqrt(1 - abar_t) epsilon."""
        alpha_bar = self.alpha_bar(t)[:, None]
        return alpha_bar.sqrt() * x_0 + (1.0 - alpha_bar).sqrt() * epsilon

    def target(
        self, x_0: Float[Tensor, "batch dimension"], epsilon: Float[Tensor, "batch dimension"], t: Int[Tensor, " batch"]
    ) -> Float[Tensor, "batch dimension"]:
        """What the network is trained to predict; v = sqrt(abar_t) epsilon - sqrt(1 - abar_t) x_0."""
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
        """x_0 estimate (diffusers: pred_original_sample) that `prediction` stands for; differentiable."""
        if self.prediction_type == "sample":
            return prediction
        alpha_bar = self.alpha_bar(t)[:, None]
        if self.prediction_type == "epsilon":
            return (x_t - (1.0 - alpha_bar).sqrt() * prediction) / alpha_bar.sqrt()
        return alpha_bar.sqrt() * x_t - (1.0 - alpha_bar).sqrt() * prediction
