"""The processes of one training run: one alone, or those that torchrun started, each with its share of every batch.

Every process draws the whole batch, which is cheap, and keeps its groups. Gradients are averaged, so all take the step
that one process would have taken with the whole batch, and keep equal weights without ever exchanging them.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, distributed

from dexnudge.diffusion.config import Precision
from dexnudge.errors import InputError


def has_bfloat16(device: torch.device) -> bool:
    """Return whether torch can compute matrix products in bfloat16 there."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    if not torch.backends.mkldnn.is_available():
        return False
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())  # noqa: SLF001 - torch has no public question for it


def check_precision(precision: Precision, device: torch.device) -> None:
    """Raise InputError for a precision that the device does not have."""
    if precision == "bfloat16" and not has_bfloat16(device):
        raise InputError(
            f"precision is bfloat16, which {device} cannot compute: expected a processor with AVX-512 or bfloat16 "
            "instructions and a torch with oneDNN, or such a GPU; set `precision` to float32."
        )


CPU = torch.device("cpu")
_VARIABLES = (("RANK", 0), ("WORLD_SIZE", 1), ("LOCAL_RANK", 0))  # of torchrun, and their values without it


@dataclass(frozen=True, kw_only=True)
class Processes:
    """rank: number of this process, 0 .. count - 1; device: where its share is computed."""

    rank: int = 0
    count: int = 1
    device: torch.device = CPU

    @property
    def is_main(self) -> bool:
        """Whether this one validates, logs and saves."""
        return self.rank == 0

    def share(self, groups: int) -> slice:
        """Return the groups of a batch that this process computes; raises InputError where they are not shared evenly."""
        if groups % self.count:
            raise InputError(
                f"a batch has {groups} groups for {self.count} processes; expected a multiple; "
                "change `groups` or torchrun's --nproc-per-node."
            )
        size = groups // self.count
        return slice(self.rank * size, (self.rank + 1) * size)

    def average(self, tensors: Sequence[Tensor]) -> None:
        """Replace each tensor by its mean over all processes."""
        if self.count == 1:
            return
        flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
        distributed.all_reduce(flat)
        flat /= self.count
        for tensor, mean in zip(tensors, flat.split([tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(mean.view_as(tensor))

    def largest(self, value: float) -> float:
        """Return the largest value that any process has; all go by it, so that they stop at the same step."""
        if self.count == 1:
            return value
        shared = torch.tensor(value, dtype=torch.float64, device=self.device)
        distributed.all_reduce(shared, op=distributed.ReduceOp.MAX)
        return float(shared)


@contextmanager
def joined_processes(device: str) -> Iterator[Processes]:
    """Join the processes that torchrun started (gloo on CPUs, nccl on CUDA), or be alone.

    device: cpu, or cuda: one GPU a process. Raises InputError where there is no such GPU.
    """
    launched = distributed.is_available() and distributed.is_torchelastic_launched()
    rank, count, local = (int(os.environ[name]) if launched else default for name, default in _VARIABLES)
    if device == "cuda" and torch.cuda.device_count() <= local:
        raise InputError(
            f"process {local} of this machine needs a CUDA device of its own; torch {torch.__version__} sees "
            f"{torch.cuda.device_count()}; set `device` to cpu, start fewer processes, or install torch for CUDA."
        )
    place = torch.device("cuda", local) if device == "cuda" else CPU
    if count > 1:
        distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield Processes(rank=rank, count=count, device=place)
        if count > 1:
            distributed.barrier()  # who leaves gloo while another still writes is aborted at its exit now and then
    finally:
        if count > 1:
            distributed.destroy_process_group()
