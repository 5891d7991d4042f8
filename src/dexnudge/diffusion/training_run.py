"""The optimiser's steps of a run: network, averaged weights and moments, and their state."""

import hashlib
import json
import math
from collections.abc import Callable
from itertools import product
from typing import Any

import torch
from torch import Tensor

from dexnudge.dataset.loading import Dataset, split_objects
from dexnudge.diffusion.batches import BatchSampler
from dexnudge.diffusion.checkpoint import STATE_NAME, load_model, shipped_or_given
from dexnudge.diffusion.config import DEFAULT_STEPS, ModelConfig, TrainingConfig
from dexnudge.diffusion.distributed import Processes, check_precision
from dexnudge.diffusion.network import ConditionalDenoiser, Normaliser
from dexnudge.diffusion.objective import diffusion_loss, loss_weights, stratified_timesteps, validate
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.errors import CheckpointError, DatasetError, DexnudgeError

NORMALISER_STREAM = 2  # random stream of the batches that the normaliser is fitted to
NORMALISER_BATCHES = 64
GROUPS = ("weights", "average", "first_moment", "second_moment")  # of tensors in a state
FINAL_LEARNING_RATE = 0.01  # as a share of the peak


class TrainingRun:
    """Takes optimiser steps; one for each process, all with equal weights.

    Attributes:
        step: steps done. progress: share of the run that is done, which the learning rate follows.
        settings, dataset_id: what a continuation must share. average: averaged weights by name, which are the model.
    """

    def __init__(self, dataset: Dataset, config: TrainingConfig, processes: Processes | None = None) -> None:
        self.config, self.processes = config, processes or Processes()
        self._device = self.processes.device
        check_precision(config.precision, self._device)
        self._share = self.processes.share(config.groups)
        manifest = dataset.manifest
        self.model_config = ModelConfig(
            hand=manifest.hand,
            joint_names=manifest.joint_names,
            joint_groups=tuple(group for group in manifest.joint_groups.values() if group),
            architecture=config.architecture,
        )
        self.num_steps = config.steps or DEFAULT_STEPS
        self.settings = {**config.identity(), "steps": self.num_steps, "processes": self.processes.count}
        self.dataset_id = _fingerprint(dataset)
        self.training_objects, self.held_out_objects = split_objects(dataset.object_names)
        self._sampler = BatchSampler(dataset, self.training_objects, config)
        try:
            self._held_out = BatchSampler(dataset, self.held_out_objects, config) if self.held_out_objects else None
        except DatasetError:  # of a tiny dataset, the few objects held out may have no row to validate on
            self._held_out = None
        self._sliding = manifest.sliding
        self._schedule = NoiseSchedule(config.architecture)
        fitted = [self._sampler.batch(k, stream=NORMALISER_STREAM).q for k in range(NORMALISER_BATCHES)]
        self.normaliser = Normaliser.fit(torch.cat(fitted), sliding=manifest.sliding).to(self._device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)  # torch's layers draw their first weights from the global generator only
            self._network = ConditionalDenoiser(self.model_config)
        if config.start_from is not None:
            take_over(self._network, load_model(shipped_or_given(config.start_from))[0])
        self._network.to(self._device)
        self._parameters: dict[str, Tensor] = dict(self._network.named_parameters())
        self.average = {name: parameter.detach().clone() for name, parameter in self._parameters.items()}
        self._optimizer = torch.optim.AdamW(
            self._parameters.values(), lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self.step, self.minutes = 0, 0.0

    @property
    def progress(self) -> float:
        """Share of the run that is done, by steps or, where that is further, by time."""
        by_time = self.minutes / self.config.max_minutes if self.config.max_minutes else 0.0
        return max(self.step / self.num_steps, by_time)

    def learning_rate(self) -> float:
        """Return the learning rate of the next step: linear warm-up, then half a cosine down to 1 % of the peak."""
        warm_up = min(1.0, (self.step + 1) / max(self.config.warmup_steps, 1))
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(self.progress, 1.0)))
        return self.config.learning_rate * warm_up * (FINAL_LEARNING_RATE + (1.0 - FINAL_LEARNING_RATE) * cosine)

    def advance(self, between: Callable[[], None] = lambda: None) -> float:
        """Take one optimiser step and return its loss.

        between: called between the parts of a step; what it raises ends the step, which has then changed nothing.

        Raises:
            DexnudgeError: the loss is not finite.
        """
        whole = self._sampler.batch(self.step)
        generator = torch.Generator().manual_seed((self.config.seed * 1_000_003 + self.step) % 2**63)
        noise = torch.randn(whole.q.shape, generator=generator)
        timesteps = stratified_timesteps(len(whole.q), self._schedule.num_train_timesteps, generator)
        batch = whole.part(self._share).to(self._device)
        rows = slice(self._share.start * self.config.rows_per_group, self._share.stop * self.config.rows_per_group)
        epsilon, t = noise[rows].to(self._device), timesteps[rows].to(self._device)
        x_0 = self.normaliser.normalise(batch.q)
        between()
        condition = batch.condition(self._network.encode(batch.points))
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self.config.precision == "bfloat16"):
            prediction = self._network(self._schedule.add_noise(x_0, epsilon, t), t, *condition.inputs).float()
        weights = loss_weights(self._schedule, t, self.config.loss_weighting, self.config.snr_limit)
        loss = diffusion_loss(prediction, self._schedule.target(x_0, epsilon, t), weights)
        self._optimizer.param_groups[0]["lr"] = self.learning_rate()
        self._optimizer.zero_grad(set_to_none=True)
        between()
        loss.backward()
        between()
        shown = loss.detach()
        self.processes.average([shown, *(p.grad for p in self._parameters.values() if p.grad is not None)])
        torch.nn.utils.clip_grad_norm_(self._parameters.values(), self.config.gradient_clip)
        self._optimizer.step()
        decay = min(self.config.ema_decay, (1.0 + self.step) / (10.0 + self.step))  # forgets the random start early
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.values()), list(self._parameters.values()), 1.0 - decay)
        if not math.isfinite(float(shown)):
            raise DexnudgeError(
                f"training diverged at step {self.step}: the loss is {float(shown)}; expected a finite loss; "
                "lower `learning_rate` or `gradient_clip`; the last good state is kept."
            )
        self.step += 1
        return float(shown)

    def validate(self) -> dict[str, float]:
        """Return the errors of the averaged weights on the held-out objects; empty where there are none."""
        if self._held_out is None:
            return {}
        averaged = ConditionalDenoiser(self.model_config).to(self._device)
        averaged.load_state_dict(self.average)
        return validate(averaged, self._held_out, self.normaliser, self._schedule, self.config, sliding=self._sliding)

    @property
    def identity(self) -> dict[str, Any]:
        """What a continuation must share."""
        return {"dataset": self.dataset_id, "config": self.settings}

    def state(self) -> dict[str, Tensor]:
        """Return, with `step` and `minutes`, everything that decides how the run goes on: GROUP/PARAMETER -> tensor."""
        moments = {name: self._optimizer.state[parameter] for name, parameter in self._parameters.items()}
        groups = {
            "weights": self._parameters,
            "average": self.average,
            "first_moment": {name: moment["exp_avg"] for name, moment in moments.items()},
            "second_moment": {name: moment["exp_avg_sq"] for name, moment in moments.items()},
        }
        return {f"{group}/{name}": tensor for group, tensors in groups.items() for name, tensor in tensors.items()}

    def restore(self, state: dict[str, Tensor], *, step: int, minutes: float) -> None:
        """Go on from a saved state; random draws depend on the step alone.

        Raises:
            CheckpointError: a tensor is missing, of another shape, or not finite.
        """
        for group, (name, parameter) in product(GROUPS, self._parameters.items()):
            saved = state.get(f"{group}/{name}")
            if saved is None or saved.shape != parameter.shape or not saved.isfinite().all():
                found = "missing" if saved is None else f"of shape {tuple(saved.shape)}, or not finite"
                raise CheckpointError(
                    f"the training state's {group}/{name} is {found}; expected finite numbers of shape "
                    f"{tuple(parameter.shape)}; delete {STATE_NAME} to start again."
                )
        self.step, self.minutes = step, minutes
        with torch.no_grad():
            for name, parameter in self._parameters.items():
                parameter.copy_(state[f"weights/{name}"])
                self.average[name] = state[f"average/{name}"].to(self._device, copy=True)
                self._optimizer.state[parameter] = {
                    "step": torch.tensor(float(step), device=self._device),
                    "exp_avg": state[f"first_moment/{name}"].to(self._device, copy=True),
                    "exp_avg_sq": state[f"second_moment/{name}"].to(self._device, copy=True),
                }


def take_over(network: ConditionalDenoiser, other: ConditionalDenoiser) -> None:
    """Set the network's weights to another one's, whose hand may differ.

    Where the hands have different joints, tokens differ in length: what the two share from the start on, the root's
    coordinates among it, is taken over, and the rest stays as it is.

    Raises:
        CheckpointError: a network of another shape.
    """
    ours, theirs = network.config.architecture, other.config.architecture
    if ours != theirs:
        raise CheckpointError(
            f"the run cannot start from a model of another architecture: expected {ours}, got {theirs}; "
            "give the run the same `architecture`, or another `start_from`."
        )
    sources = dict(other.named_parameters())
    with torch.no_grad():
        for name, target in network.named_parameters():
            shared = tuple(slice(min(sizes)) for sizes in zip(target.shape, sources[name].shape, strict=True))
            target[shared] = sources[name][shared]


def _fingerprint(dataset: Dataset) -> str:
    digest = hashlib.sha256(json.dumps([dataset.manifest.hand, dataset.object_names]).encode())
    for array in (dataset.q, dataset.behaviour, dataset.direction_margin, dataset.clouds, dataset.turn_margin):
        digest.update(array.tobytes())
    return digest.hexdigest()
