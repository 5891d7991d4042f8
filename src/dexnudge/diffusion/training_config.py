"""Everything that decides how a model is trained."""

import math
from dataclasses import asdict, dataclass, field
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.diffusion.compute import Precision
from dexnudge.diffusion.config import Architecture
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.errors import InputError

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


# may differ between a run and its continuation, because they do not change the weights of a run with max_minutes unset
_BUDGET_FIELDS = ("max_minutes", "checkpoint_every", "validate_every", "log_every", "num_threads")
_SHARES = ("grasp_fraction", "behaviour_balance", "unconditional_fraction", "direction_dropout", "behaviour_dropout")


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of `train`.

    A batch has `groups` x `rows_per_group` configurations. A group is one object turned to frame C with one direction of
    motion, whose surface is encoded once.

    Attributes:
        steps: optimiser steps of the whole run; the learning rate follows a cosine over them.
        max_minutes: time budget over all continuations; the learning rate then follows whichever of steps and time is
            further advanced, and weights are no longer reproducible bit by bit.
        grasp_fraction: share of groups that are grasps; 1 trains on grasps only, 0 on none.
        behaviour_balance: 0 draws the rows of a group evenly; 1 draws push, press and hook equally often where a group has
            them, however many rows each of them has; between, counts are evened out by that power.
        unconditional_fraction, direction_dropout, behaviour_dropout: shares of groups that lose class and direction, the
            direction, the class.
        min_direction_margin: force margin from which a configuration counts as able to move the object in a direction.
        yaw_jitter: half-width of the uniform error of frame C's yaw [rad].
        point_noise: standard deviation of noise on surface points [m]; num_points: random subset a group.
        scale_jitter: half-width of the uniform relative error of the cloud's size, about the origin of frame C: what a mesh
            measured wrong looks like. Hands are not scaled with it: a hand has one size, and it touched the true object.
        loss_weighting, snr_limit: see `loss.py`. ema_decay: of the averaged weights that are shipped.
        num_threads: of torch; None leaves it as it is.
        device: cpu, or cuda, one GPU a process. precision: see `precision.py`.
    """

    steps: int = 20_000
    max_minutes: float | None = None
    groups: int = 16
    rows_per_group: int = 16
    learning_rate: float = 1e-3
    warmup_steps: int = 500
    weight_decay: float = 0.01
    gradient_clip: float = 1.0
    ema_decay: float = 0.999
    grasp_fraction: float = 0.25
    behaviour_balance: float = 0.5
    unconditional_fraction: float = 0.1
    direction_dropout: float = 0.1
    behaviour_dropout: float = 0.1
    min_direction_margin: float = 1.0
    yaw_jitter: float = 0.0873
    point_noise: float = 5e-4
    scale_jitter: float = 0.01
    num_points: int = 256
    loss_weighting: LossWeighting = "uniform"
    snr_limit: float = 5.0
    validate_every: int = 1000
    checkpoint_every: int = 1000
    log_every: int = 50
    seed: int = 0
    num_threads: int | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    precision: Precision = "float32"
    architecture: Architecture = field(default_factory=Architecture)

    def __post_init__(self) -> None:
        counts = ("steps", "groups", "rows_per_group", "num_points", "validate_every", "checkpoint_every", "log_every")
        for name in counts:
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}, expected at least 1.")
        for name in _SHARES:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"{name} is {getattr(self, name)}, expected a share between 0 and 1.")
        for name in ("yaw_jitter", "point_noise"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} is {getattr(self, name)}, expected 0 or more.")
        if not 0.0 <= self.scale_jitter < 1.0:
            raise InputError(f"scale_jitter is {self.scale_jitter}, expected a relative error from 0 to below 1.")
        if self.max_minutes is not None and self.max_minutes <= 0.0:
            raise InputError(f"max_minutes is {self.max_minutes}, expected more than 0, or None for no limit.")

    def identity(self) -> dict[str, object]:
        """The settings that a continuation must share with the run that it continues."""
        return {name: value for name, value in asdict(self).items() if name not in _BUDGET_FIELDS}
