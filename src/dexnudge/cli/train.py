"""`dexnudge train`: the diffusion model, from a dataset folder."""

import os
from contextlib import nullcontext
from dataclasses import dataclass, field

from dexnudge.cli.arguments import Folder, Folders
from dexnudge.diffusion.config import TrainingConfig

INTERRUPTED = 130  # what shells report for a command that Ctrl-C stopped


@dataclass(frozen=True)
class Train:
    """Train the diffusion model on a dataset; a stopped run goes on where it was, with the settings that it began with.

    Ctrl-C and SIGTERM end the run at the current step with everything saved. `torchrun --nproc-per-node N -m dexnudge
    train ...` shares it among N processes.
    """

    data: Folders
    """Folder that `dataset generate` wrote; several of one hand are taken together."""
    out: Folder
    """Folder of the run: checkpoints, logs, and in model/ what --weights takes, with its card."""
    training: TrainingConfig = field(default_factory=TrainingConfig)

    def run(self) -> int:
        """Train until done, out of time, or stopped."""
        from dexnudge.cli.arguments import stdout
        from dexnudge.dataset.manifest import read_manifest
        from dexnudge.diffusion.training import train
        from dexnudge.jobs.folders import owned_folder
        from dexnudge.jobs.provenance import machine, versions

        console = stdout()
        for folder in self.data:
            read_manifest(folder)  # a missing dataset is refused before anything is made
        # The first process of torchrun writes; the others own nothing.
        with owned_folder(self.out) if os.environ.get("RANK", "0") == "0" else nullcontext():
            result = train(
                self.data,
                self.out,
                self.training,
                made_with={**machine(self.training.device), **versions()},
                on_plan=lambda plan: console.print(str(plan), soft_wrap=True),
            )
        if not result.is_main:
            return 0 if result.finished else INTERRUPTED
        for name, value in result.validation.items():
            console.print(f"{name}: {value:.4g}")
        kept = f"model: {result.model_folder}" if result.model_folder.is_dir() else "nothing to keep yet"
        console.print(f"{result.step} steps in {result.minutes:.1f} min; {kept}", soft_wrap=True)
        if not result.finished:
            raise KeyboardInterrupt
        return 0
