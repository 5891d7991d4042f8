"""What training minimises, and what is reported of it on held-out objects."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.diffusion.batches import BatchSampler
from dexnudge.diffusion.config import LossWeighting, TrainingConfig
from dexnudge.diffusion.network import ConditionalDenoiser, Normaliser
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.hands.hand import ROOT_COORDINATES

_SMALLEST_SNR = 1e-4  # zero at the last step of a zero-terminal-SNR schedule; keeps the ratio of weights finite


def loss_weights(
    schedule: NoiseSchedule, t: Int[Tensor, " batch"], weighting: LossWeighting, snr_limit: float
) -> Float[Tensor, " batch"]:
    """Return the factor on the squared error of what `schedule` predicts."""
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
    """Return the weighted mean of the squared error over batch and dimensions."""
    return (weights[:, None] * (prediction - target).square()).mean()


def stratified_timesteps(num: int, num_train_timesteps: int, generator: torch.Generator) -> Int[Tensor, " num"]:
    """Return uniform timesteps, one from each of `num` equal strata, in random order: less noise in the loss."""
    strata = torch.randperm(num, generator=generator)
    uniform = (strata + torch.rand(num, generator=generator)) / num
    return (uniform * num_train_timesteps).long().clamp(max=num_train_timesteps - 1)


REPORTED_LEVELS = (0.05, 0.25, 0.5, 0.75)  # of the train timesteps
_NUM_BATCHES = 4  # the same ones every time, so that values can be compared over a run
_STREAM = 1  # random stream apart from the training batches'
_MM, _DEGREES = 1000.0, 180.0 / torch.pi


@torch.inference_mode()
def validate(
    network: ConditionalDenoiser,
    sampler: BatchSampler,
    normaliser: Normaliser,
    schedule: NoiseSchedule,
    config: TrainingConfig,
    *,
    sliding: Bool[np.ndarray, " joint"],
) -> dict[str, float]:
    """Return the loss over all noise levels, and per reported level the RMS error of the clean estimate.

    Translation [mm], joint angles [deg] and `sliding` joints [mm], over batches that are the same at every call.
    """
    losses = []
    device = normaliser.mean.device
    slides = torch.as_tensor(np.flatnonzero(sliding)) + ROOT_COORDINATES
    turns = torch.as_tensor(np.flatnonzero(~sliding)) + ROOT_COORDINATES
    parts = {"translation_mm": (torch.arange(3), _MM), "joints_deg": (turns, _DEGREES), "slides_mm": (slides, _MM)}
    parts = {name: (columns, unit) for name, (columns, unit) in parts.items() if len(columns)}
    squares = {level: torch.zeros(len(parts)) for level in REPORTED_LEVELS}
    for index in range(_NUM_BATCHES):
        batch = sampler.batch(index, stream=_STREAM).to(device)
        generator = torch.Generator().manual_seed(index)
        x_0 = normaliser.normalise(batch.q)
        epsilon = torch.randn(x_0.shape, generator=generator).to(device)
        condition = batch.condition(network.encode(batch.points))
        t = torch.randint(schedule.num_train_timesteps, (len(x_0),), generator=generator).to(device)
        prediction = network(schedule.add_noise(x_0, epsilon, t), t, *condition.inputs)
        weights = loss_weights(schedule, t, config.loss_weighting, config.snr_limit)
        losses.append(float(diffusion_loss(prediction, schedule.target(x_0, epsilon, t), weights)))
        for level in REPORTED_LEVELS:
            t = torch.full((len(x_0),), round(level * schedule.num_train_timesteps), device=device)
            x_t = schedule.add_noise(x_0, epsilon, t)
            error = schedule.clean_estimate(network(x_t, t, *condition.inputs), x_t, t) - x_0
            error = error * normaliser.std
            squares[level] += torch.stack([error[:, columns].square().mean() for columns, _ in parts.values()]).cpu()
    report = {"validation/loss": sum(losses) / len(losses)}
    for level, total in squares.items():
        for (name, (_, unit)), error in zip(parts.items(), (total / _NUM_BATCHES).sqrt().tolist(), strict=True):
            report[f"validation/{name}_at_{level}"] = error * unit
    return report
