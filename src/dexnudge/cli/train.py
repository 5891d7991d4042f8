"""`dexnudge train`: the diffusion model, from a dataset folder."""

import os
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from dexnudge.cli.arguments import Count, Folder, OptionalCount, OptionalNumber, check_at_least, metavar

INTERRUPTED = 130  # what shells report for a command that Ctrl-C stopped


@dataclass(frozen=True)
class Network:
    """Shape of the network and what it predicts; those of `dexnudge.diffusion.config.Architecture` unless given."""

    width: OptionalCount = None
    """Channels of the transformer; 128 unless given."""
    depth: OptionalCount = None
    """Blocks of the transformer; 6 unless given."""
    num_heads: OptionalCount = None
    """Attention heads; 4 unless given."""
    token_layout: Literal["digits", "single", "scalars"] | None = None
    """One token a digit, one for all, or one a coordinate; digits unless given."""
    prediction_type: Literal["epsilon", "sample", "v_prediction"] | None = None
    """What the network predicts; v_prediction unless given."""
    schedule: Literal["cosine", "linear"] | None = None
    """Noise schedule; cosine unless given."""
    zero_terminal_snr: bool | None = None
    """Whether the last step is pure noise; True unless given, but for epsilon, where it cannot be."""


@dataclass(frozen=True)
class Batches:
    """What the batches are made of; as in `dexnudge.diffusion.training_config.TrainingConfig` unless given."""

    groups: OptionalCount = None
    """Objects, each with one direction of motion, in a batch; 16 unless given."""
    rows_per_group: OptionalCount = None
    """Configurations of each of them; 16 unless given."""
    grasp_fraction: OptionalNumber = None
    """Share of grasps; 0.25 unless given, 1 trains the grasp-only baseline."""
    behaviour_balance: OptionalNumber = None
    """0 draws rows evenly, 1 draws push, press and hook equally often; 0.5 unless given."""
    min_direction_margin: OptionalNumber = None
    """Force margin from which a configuration counts as able to move the object; 1 unless given."""
    unconditional_fraction: OptionalNumber = None
    """Share that loses class and direction; 0.1 unless given."""
    direction_dropout: OptionalNumber = None
    """Share that loses the direction; 0.1 unless given."""
    behaviour_dropout: OptionalNumber = None
    """Share that loses the class; 0.1 unless given."""
    yaw_jitter: OptionalNumber = None
    """Largest error of the motion's direction [rad]; 0.0873 unless given."""
    scale_jitter: OptionalNumber = None
    """Largest relative error of the object's size; 0.01 unless given."""
    point_noise: OptionalNumber = None
    """Standard deviation of the error of surface points [m]; 0.0005 unless given."""


@dataclass(frozen=True)
class Reports:
    """How often a run validates and saves; neither changes its weights."""

    validate_every: OptionalCount = None
    """Steps between validations on held-out objects; 1000 unless given."""
    checkpoint_every: OptionalCount = None
    """Steps between saved states; 1000 unless given."""


@dataclass(frozen=True)
class Compute:
    """Where and how a run is computed. `torchrun --nproc-per-node N -m dexnudge train ...` shares it among N processes."""

    num_threads: OptionalCount = None
    """Threads of torch; its own choice unless given."""
    device: Literal["cpu", "cuda"] = "cpu"
    """cuda takes one GPU for each process."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """bfloat16 is slower on processors without units for matrices in it, such as AMX."""


@dataclass(frozen=True)
class Train:
    """Train the diffusion model on a dataset; a stopped run goes on where it was.

    Ctrl-C and SIGTERM end the run after the current step with everything saved.
    """

    data: Folder
    """Folder that `dataset generate` wrote."""
    out: Folder
    """Folder of the run: checkpoints, logs, and in model/ what --weights takes, with its card."""
    steps: OptionalCount = None
    """Optimiser steps; 20000 unless given."""
    max_minutes: OptionalNumber = None
    """Time budget over all continuations [min]; none unless given."""
    seed: Count = 0
    """Of weights, noise and batches."""
    learning_rate: Annotated[float | None, metavar("X")] = None
    """Peak learning rate; 0.001 unless given."""
    loss_weighting: Literal["uniform", "min_snr", "velocity"] | None = None
    """Weight of the loss over noise levels; uniform unless given."""
    batches: Batches = field(default_factory=Batches)
    compute: Compute = field(default_factory=Compute)
    reports: Reports = field(default_factory=Reports)
    network: Network = field(default_factory=Network)

    def run(self) -> int:
        """Train until done, out of time, or stopped."""
        check_at_least(0, seed=self.seed)
        from dexnudge.cli.arguments import stdout
        from dexnudge.dataset.manifest import read_manifest
        from dexnudge.diffusion.training import train
        from dexnudge.jobs.folders import owned_folder
        from dexnudge.jobs.provenance import machine, versions

        config = self.config()
        read_manifest(self.data)  # a missing dataset is refused before anything is made
        # The first process of torchrun writes; the others own nothing.
        with owned_folder(self.out) if os.environ.get("RANK", "0") == "0" else nullcontext():
            result = train(self.data, self.out, config, made_with={**machine(config.device), **versions()})
        if not result.is_main:
            return 0 if result.finished else INTERRUPTED
        console = stdout()
        for name, value in result.validation.items():
            console.print(f"{name}: {value:.4g}")
        console.print(f"{result.step} steps in {result.minutes:.1f} min; model: {result.model_folder}", soft_wrap=True)
        if not result.finished:
            console.print("stopped before the end; the same command goes on from here")
            return INTERRUPTED
        return 0

    def config(self) -> Any:
        """The `TrainingConfig` that the options stand for."""
        from dexnudge.diffusion.config import Architecture
        from dexnudge.diffusion.training_config import TrainingConfig

        own = _given(self, without=("data", "out", "batches", "compute", "reports", "network"))
        settings = {**own, **_given(self.batches), **_given(self.compute), **_given(self.reports)}
        return TrainingConfig(**settings, architecture=Architecture(**_given(self.network)))


def _given(options: object, *, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """The options that have a value, by name."""
    return {name: value for name, value in vars(options).items() if name not in without and value is not None}
