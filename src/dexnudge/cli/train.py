"""`dexnudge train`: the diffusion model, from a dataset folder."""

from dataclasses import dataclass
from pathlib import Path

from dexnudge.cli.arguments import Count, Folder, OptionalNumber, Text


@dataclass(frozen=True)
class Train:
    """Train the diffusion model on a dataset; a stopped run goes on where it was."""

    data: Folder
    """Folder that `dataset generate` wrote."""
    out: Folder
    """Folder of the run: checkpoints, logs, and the model to sample with."""
    hand: Text = "shadow_lite"
    """Hand of the dataset."""
    seed: Count = 0
    """Of weights, noise and batches."""
    max_minutes: OptionalNumber = None
    """Stop, with a checkpoint, after this time."""
    device: Text = "cpu"
    """torch device to train on."""

    def run(self) -> int:
        """Train until done or out of time."""
        from dexnudge.diffusion.training import TrainingConfig, train

        train(
            Path(self.data),
            Path(self.out),
            TrainingConfig(seed=self.seed, device=self.device),
            max_minutes=self.max_minutes,
        )
        return 0
