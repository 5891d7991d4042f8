"""How well held-out objects are denoised."""

import torch

from dexnudge.diffusion.batches import BatchSampler
from dexnudge.diffusion.loss import diffusion_loss, loss_weights
from dexnudge.diffusion.network import ConditionalDenoiser
from dexnudge.diffusion.normaliser import Normaliser
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.diffusion.training_config import TrainingConfig

NUM_BATCHES = 4  # the same ones every time, so that values can be compared over a run
STREAM = 1  # random stream apart from the training batches'
REPORTED_LEVELS = (0.05, 0.25, 0.5, 0.75)  # of the train timesteps
_MM, _DEGREES = 1000.0, 180.0 / torch.pi


@torch.inference_mode()
def validate(
    network: ConditionalDenoiser,
    sampler: BatchSampler,
    normaliser: Normaliser,
    schedule: NoiseSchedule,
    config: TrainingConfig,
) -> dict[str, float]:
    """Loss over all noise levels, and per reported level the RMS error of the clean estimate.

    Translation [mm] and joint angles [deg], over batches that are the same at every call.
    """
    losses = []
    device = normaliser.mean.device
    squares = {level: torch.zeros(2) for level in REPORTED_LEVELS}
    for index in range(NUM_BATCHES):
        batch = sampler.batch(index, stream=STREAM).to(device)
        generator = torch.Generator().manual_seed(index)
        x_0 = normaliser.normalise(batch.q)
        epsilon = torch.randn(x_0.shape, generator=generator).to(device)
        condition = batch.condition(network.encode(batch.points))
        inputs = (condition.object_feature, condition.behaviour, condition.direction, condition.has_direction)
        t = torch.randint(schedule.num_train_timesteps, (len(x_0),), generator=generator).to(device)
        prediction = network(schedule.add_noise(x_0, epsilon, t), t, *inputs)
        weights = loss_weights(schedule, t, config.loss_weighting, config.snr_limit)
        losses.append(float(diffusion_loss(prediction, schedule.target(x_0, epsilon, t), weights)))
        for level in REPORTED_LEVELS:
            t = torch.full((len(x_0),), round(level * schedule.num_train_timesteps), device=device)
            x_t = schedule.add_noise(x_0, epsilon, t)
            error = (schedule.clean_estimate(network(x_t, t, *inputs), x_t, t) - x_0) * normaliser.std
            squares[level] += torch.stack([error[:, :3].square().mean(), error[:, 9:].square().mean()]).cpu()
    report = {"validation/loss": sum(losses) / len(losses)}
    for level, total in squares.items():
        translation, joints = (total / NUM_BATCHES).sqrt().tolist()
        report[f"validation/translation_mm_at_{level}"] = translation * _MM
        report[f"validation/joints_deg_at_{level}"] = joints * _DEGREES
    return report
