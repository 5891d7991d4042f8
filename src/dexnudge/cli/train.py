"""`dexnudge train`: the diffusion model, from a dataset folder."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

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
    prediction_type: Literal["epsilon", "sample", "v_prediction"] | None = None
    """What the network predicts; v_prediction unless given."""
    schedule: Literal["cosine", "linear"] | None = None
    """Noise schedule; cosine unless given."""


@dataclass(frozen=True)
class Train:
    """Train the diffusion model on a dataset; a stopped run goes on where it was.

    Ctrl-C and SIGTERM end the run after the current step with everything saved.
    """

    data: Folder
    """Folder that `dataset generate` wrote."""
    out: Folder
    """Folder of the run: checkpoints, logs, and in model/ what --weights takes."""
    steps: OptionalCount = None
    """Optimiser steps; 20000 unless given."""
    max_minutes: OptionalNumber = None
    """Time budget over all continuations [min]; none unless given."""
    seed: Count = 0
    """Of weights, noise and batches."""
    groups: OptionalCount = None
    """Objects, each with one direction of motion, in a batch; 16 unless given."""
    rows_per_group: OptionalCount = None
    """Configurations of each of them; 16 unless given."""
    learning_rate: Annotated[float | None, metavar("X")] = None
    """Peak learning rate; 0.001 unless given."""
    grasp_fraction: OptionalNumber = None
    """Share of grasps in the batches; 0.25 unless given, 1 trains the grasp-only baseline."""
    loss_weighting: Literal["uniform", "min_snr", "velocity"] | None = None
    """Weight of the loss over noise levels; uniform unless given."""
    num_threads: OptionalCount = None
    """Threads of torch; its own choice unless given."""
    network: Network = field(default_factory=Network)

    def run(self) -> int:
        """Train until done, out of time, or stopped."""
        check_at_least(0, seed=self.seed)
        from dexnudge.cli.console import stdout
        from dexnudge.dataset.manifest import read_manifest
        from dexnudge.diffusion.config import Architecture
        from dexnudge.diffusion.training import train
        from dexnudge.diffusion.training_config import TrainingConfig
        from dexnudge.results.new_folder import check_writable_place

        read_manifest(self.data)  # a missing dataset is refused before anything is made
        check_writable_place(self.out)
        own = {"data", "out", "network"}
        settings = {name: value for name, value in vars(self).items() if name not in own and value is not None}
        shape = {name: value for name, value in vars(self.network).items() if value is not None}
        result = train(self.data, self.out, TrainingConfig(**settings, architecture=Architecture(**shape)))
        console = stdout()
        for name, value in result.validation.items():
            console.print(f"{name}: {value:.4g}")
        console.print(f"{result.step} steps in {result.minutes:.1f} min; model: {result.model_folder}", soft_wrap=True)
        if not result.finished:
            console.print("stopped before the end; the same command goes on from here")
            return INTERRUPTED
        return 0
