"""The training loss: mean squared error of the prediction, weighted over the noise levels.

SNR(t) = abar_t / (1 - abar_t). An error e of the clean estimate is an error SNR e^2 of epsilon and (SNR + 1) e^2 of v.

    uniform   ||target - prediction||^2; with epsilon prediction this is the paper's Eq. 2
    min_snr   weight min(SNR, limit) on the error of x_0, whatever is predicted (Hang et al., 2023)
    velocity  weight min(SNR + 1, limit): as `uniform` with v-prediction, capped where almost no noise is left
"""

from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.diffusion.schedule import NoiseSchedule

LossWeighting = Literal["uniform", "min_snr", "velocity"]
_SMALLEST_SNR = 1e-4  # zero at the last step of a zero-terminal-SNR schedule; keeps the ratio of weights finite


def loss_weights(
    schedule: NoiseSchedule, t: Int[Tensor, " batch"], weighting: LossWeighting, snr_limit: float
) -> Float[Tensor, " batch"]:
    """Factor on the squared error of what `schedule` predicts."""
    if weighting == "uniform":
        return torch.ones(len(t), device=t.device)
    alpha_bar = schedule.alpha_bar(t)
    snr = (alpha_bar / (1.0 - alpha_bar)).clamp(min=_SMALLEST_SNR)
    on_clean = snr.clamp(max=snr_limit) if weighting == "min_snr" else (snr + 1.0).clamp(max=snr_limit)
    per_clean_error = {"sample": torch.ones_like(snr), "epsilon": snr, "v_prediction": snr + 1.0}
    return on_clean / per_clean_error[schedule.prediction_type]


def diffusion_loss(
    prediction: Float[Tensor, "batch dimension"],
    target: Float[Tensor, "batch dimension"],
    weights: Float[Tensor, " batch"],
) -> Float[Tensor, ""]:
    """Weighted mean over batch and dimensions."""
    return (weights[:, None] * (prediction - target).square()).mean()
