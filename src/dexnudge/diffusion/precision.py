"""In which precision the transformer is computed while training; weights, optimiser and point encoder stay float32.

The encoder is left out because bfloat16 has 8 bits: a rim 0.1 m away would be known to 0.4 mm only. float32 is the default
because bfloat16 pays only where a machine has units for matrices in it (tensor cores, AMX). With AVX-512 alone, bfloat16
dot products included, a step of the default network took 1.57 times the processor time of float32, on one thread
(`benchmarks/training.py`): the conversions cost more than they save.
"""

from contextlib import AbstractContextManager
from typing import Literal

import torch

from dexnudge.errors import InputError

Precision = Literal["float32", "bfloat16"]


def has_bfloat16(device: torch.device) -> bool:
    """Whether torch can compute matrix products in bfloat16 there."""
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
            "instructions and a torch with oneDNN, or such a GPU; train with --precision float32."
        )


def computed_in(precision: Precision, device: torch.device) -> AbstractContextManager[object]:
    """Context in which the transformer's products are computed; float32 changes nothing."""
    return torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16")
