"""One training run in memory: how a step is made, what is saved, how it is taken up again."""

import hashlib
import importlib.util
import json
import math
import time
from dataclasses import asdict
from pathlib import Path

import torch
from jaxtyping import Int
from torch import Tensor

from dexnudge.dataset.loading import Dataset, split_objects
from dexnudge.diffusion.batches import BatchSampler
from dexnudge.diffusion.checkpoint import save_model
from dexnudge.diffusion.compute import Processes, check_precision, computed_in
from dexnudge.diffusion.config import ModelConfig
from dexnudge.diffusion.network import ConditionalDenoiser
from dexnudge.diffusion.normaliser import Normaliser
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.diffusion.training_config import TrainingConfig, diffusion_loss, loss_weights
from dexnudge.diffusion.training_state import TrainingState, load_state, restore_moments, save_state
from dexnudge.errors import DexnudgeError

LOG_NAME = "train.jsonl"


class TrainingLog:
    """Appends to `train.jsonl` and to `tensorboard/`, until `close`.

    Lines from steps after `step`, written before a crash and about to be repeated, are dropped.
    """

    def __init__(self, folder: Path, *, step: int) -> None:
        path = folder / LOG_NAME
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.is_file() else []
        kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]
        self._file = path.open("w", encoding="utf-8")
        self._file.writelines(kept)
        self._writer = None
        if importlib.util.find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1)

    def write(self, step: int, values: dict[str, float]) -> None:
        """One event; the file is flushed so that it can be followed."""
        self._file.write(json.dumps({"step": step, **{name: round(value, 6) for name, value in values.items()}}) + "\n")
        self._file.flush()
        if self._writer is not None:
            for name, value in values.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close both."""
        self._file.close()
        if self._writer is not None:
            self._writer.close()


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


MODEL_FOLDER = "model"  # inside the run's folder
NORMALISER_STREAM = 2  # random stream of the batches that the normaliser is fitted to
NORMALISER_BATCHES = 64
FINAL_LEARNING_RATE = 0.01  # as a share of the peak
LOSS_SMOOTHING = 0.98  # of the loss that is shown


class TrainingRun:
    """A run in memory: network, averaged weights, optimiser and counters; one for each process, with equal weights."""

    def __init__(
        self, dataset: Dataset, folder: Path, config: TrainingConfig, processes: Processes | None = None
    ) -> None:
        manifest = dataset.manifest
        self.folder, self.config = folder, config
        self.processes = processes or Processes()
        self.device = self.processes.device
        check_precision(config.precision, self.device)
        self.share = self.processes.share(config.groups)
        self.dataset_id = _fingerprint(dataset)
        self.model_config = ModelConfig(
            hand=manifest.hand,
            joint_names=manifest.joint_names,
            joint_groups=tuple(manifest.joint_groups.values()),
            architecture=config.architecture,
        )
        self.schedule = config.architecture.noise_schedule()
        training, held_out = split_objects(dataset.object_names)
        self.sampler = BatchSampler(dataset, training, config)
        self.validation_sampler = BatchSampler(dataset, held_out, config) if held_out else None
        fitted = [self.sampler.batch(k, stream=NORMALISER_STREAM).q for k in range(NORMALISER_BATCHES)]
        self.normaliser = Normaliser.fit(torch.cat(fitted)).to(self.device)
        self.settings = {**config.identity(), "processes": self.processes.count}
        self.provenance = {
            "dataset": self.dataset_id,
            "objects": len(training),
            "held_out_objects": [dataset.object_names[k] for k in held_out],
            "configurations": len(dataset),
            "config": {**asdict(config), "processes": self.processes.count},
        }
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)  # torch's layers draw their first weights from the global generator only
            self.network = ConditionalDenoiser(self.model_config).to(self.device)
        self.parameters: dict[str, Tensor] = dict(self.network.named_parameters())
        self.average = {name: parameter.detach().clone() for name, parameter in self.parameters.items()}
        self.optimizer = torch.optim.AdamW(
            self.parameters.values(), lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self.step, self.minutes, self.mean_loss = 0, 0.0, math.nan
        self.validation: dict[str, float] = {}
        self._logged_at = (0, 0.0)
        state = load_state(folder, self.settings, self.dataset_id)
        if state is not None:
            self._restore(state)

    @property
    def progress(self) -> float:
        """Share of the run that is done, by steps or by time."""
        by_time = self.minutes / self.config.max_minutes if self.config.max_minutes else 0.0
        return max(self.step / self.config.steps, by_time)

    @property
    def finished(self) -> bool:
        """True when the steps or the time are used up."""
        return self.progress >= 1.0

    def advance(self, log: TrainingLog | None) -> None:
        """One optimiser step, with whatever is due after it; `log` only where this is the main process."""
        started = time.perf_counter()
        loss = self._optimise()
        if not math.isfinite(loss):
            raise DexnudgeError(
                f"training diverged at step {self.step}: the loss is {loss}; expected a finite loss; "
                "lower learning_rate or gradient_clip; the last good state is kept."
            )
        self.mean_loss = (
            loss if math.isnan(self.mean_loss) else LOSS_SMOOTHING * self.mean_loss + (1.0 - LOSS_SMOOTHING) * loss
        )
        self.step += 1
        self.minutes += self.processes.largest(time.perf_counter() - started) / 60.0
        if log is not None:
            self._report(log)
        if self.step % self.config.checkpoint_every == 0 or self.finished:
            self.save()

    def _report(self, log: TrainingLog) -> None:
        if self.step % self.config.log_every == 0:
            since_step, since_minutes = self._logged_at
            rate = (self.step - since_step) / max(60.0 * (self.minutes - since_minutes), 1e-9)
            self._logged_at = (self.step, self.minutes)
            values = {
                "train/loss": self.mean_loss,
                "train/learning_rate": self.learning_rate(),
                "train/steps_per_s": rate,
            }
            log.write(self.step, values)
        if self.validation_sampler is not None and (self.step % self.config.validate_every == 0 or self.finished):
            self.validation = self._validate(self.validation_sampler)
            log.write(self.step, self.validation)

    def learning_rate(self) -> float:
        """Linear warm-up, then half a cosine down to 1 % of the peak."""
        warm_up = min(1.0, (self.step + 1) / max(self.config.warmup_steps, 1))
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(self.progress, 1.0)))
        return self.config.learning_rate * warm_up * (FINAL_LEARNING_RATE + (1.0 - FINAL_LEARNING_RATE) * cosine)

    def save(self) -> None:
        """Training state first, then the model that is shipped; by the main process only, and not before the first step."""
        if self.step == 0 or not self.processes.is_main:
            return
        moments = {name: self.optimizer.state[parameter] for name, parameter in self.parameters.items()}
        state = TrainingState(
            step=self.step,
            minutes=self.minutes,
            validation=self.validation,
            weights=dict(self.parameters),
            average=self.average,
            first_moment={name: moment["exp_avg"] for name, moment in moments.items()},
            second_moment={name: moment["exp_avg_sq"] for name, moment in moments.items()},
        )
        save_state(self.folder, state, self.settings, self.dataset_id)
        provenance = {**self.provenance, "step": self.step, "validation": self.validation}
        save_model(self.folder / MODEL_FOLDER, self.model_config, self.average, self.normaliser, provenance=provenance)

    def _optimise(self) -> float:
        whole = self.sampler.batch(self.step)
        generator = torch.Generator().manual_seed(self.config.seed * 1_000_003 + self.step)
        noise = torch.randn(whole.q.shape, generator=generator)
        timesteps = _stratified_timesteps(len(whole.q), self.schedule.num_train_timesteps, generator)
        batch = whole.part(self.share).to(self.device)
        rows = slice(self.share.start * self.config.rows_per_group, self.share.stop * self.config.rows_per_group)
        epsilon, t = noise[rows].to(self.device), timesteps[rows].to(self.device)
        x_0 = self.normaliser.normalise(batch.q)
        condition = batch.condition(self.network.encode(batch.points))
        with computed_in(self.config.precision, self.device):
            prediction = self.network(
                self.schedule.add_noise(x_0, epsilon, t),
                t,
                condition.object_feature,
                condition.behaviour,
                condition.direction,
                condition.has_direction,
            ).float()
        weights = loss_weights(self.schedule, t, self.config.loss_weighting, self.config.snr_limit)
        loss = diffusion_loss(prediction, self.schedule.target(x_0, epsilon, t), weights)
        self.optimizer.param_groups[0]["lr"] = self.learning_rate()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        shown = loss.detach()
        self.processes.average([shown, *(p.grad for p in self.parameters.values() if p.grad is not None)])
        torch.nn.utils.clip_grad_norm_(self.parameters.values(), self.config.gradient_clip)
        self.optimizer.step()
        decay = min(self.config.ema_decay, (1.0 + self.step) / (10.0 + self.step))  # forgets the random start early
        with torch.no_grad():
            average = [self.average[name] for name in self.parameters]  # a restored state comes in another order
            torch._foreach_lerp_(average, list(self.parameters.values()), 1.0 - decay)
        return float(shown)

    def _validate(self, sampler: BatchSampler) -> dict[str, float]:
        averaged = ConditionalDenoiser(self.model_config).to(self.device)
        averaged.load_state_dict(self.average)
        return validate(averaged, sampler, self.normaliser, self.schedule, self.config)

    def _restore(self, state: TrainingState) -> None:
        self.step, self.minutes, self.validation = state.step, state.minutes, state.validation
        self._logged_at = (state.step, state.minutes)
        self.network.load_state_dict(state.weights)
        self.average = {name: tensor.to(self.device) for name, tensor in state.average.items()}
        restore_moments(self.optimizer, self.parameters, state)


def _stratified_timesteps(num: int, num_train_timesteps: int, generator: torch.Generator) -> Int[Tensor, " num"]:
    """Uniform timesteps, one from each of `num` equal strata, in random order: less noise in the loss."""
    strata = torch.randperm(num, generator=generator)
    uniform = (strata + torch.rand(num, generator=generator)) / num
    return (uniform * num_train_timesteps).long().clamp(max=num_train_timesteps - 1)


def _fingerprint(dataset: Dataset) -> str:
    digest = hashlib.sha256(json.dumps([dataset.manifest.hand, dataset.object_names]).encode())
    for array in (dataset.q, dataset.behaviour, dataset.direction_margin, dataset.clouds):
        digest.update(array.tobytes())
    return digest.hexdigest()
