"""Where tensors and Warp arrays lie and kernels run: on the CPU, or on one CUDA device of this machine.

What takes a `device` runs the same code on each. Random numbers are drawn on the CPU and copied, so that a seed means the
same draws everywhere, up to rounding.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import torch

from dexnudge.errors import InputError, quote
from dexnudge.geometry.warp_runtime import wp


def check_device(name: str) -> str:
    """Return the full name of a device, "cpu" or "cuda:N"; "cuda" is torch's current one.

    Raises:
        InputError: no such device, or no CUDA at all.
    """
    kind, _, number = name.partition(":") if isinstance(name, str) else ("", "", "")
    if name == "cpu":
        return name
    if kind != "cuda" or (name != kind and not (number.isascii() and number.isdigit())):
        raise InputError(f"`device` is {quote(name)}; expected cpu, cuda, or one of several as cuda:1")
    count = torch.cuda.device_count() if torch.cuda.is_available() and wp.is_cuda_available() else 0
    if not count:
        built = f"for CUDA {torch.version.cuda}" if torch.version.cuda else "without CUDA"
        raise InputError(
            f"`device` is '{name}', but torch and Warp find no CUDA device here (torch {torch.__version__} is built "
            f"{built}); expected cpu; or install the NVIDIA driver and a torch that is built for CUDA"
        )
    index = int(number) if number else torch.cuda.current_device()
    if index >= count:
        there = "cuda:0" if count == 1 else f"cuda:0 to cuda:{count - 1}"
        raise InputError(f"`device` is '{name}'; expected cpu or what this machine has: {there}")
    return f"cuda:{index}"


@contextmanager
def torch_stream(device: str) -> Iterator[None]:
    """Have Warp work on torch's current stream of a CUDA device while the block runs: neither overtakes the other."""
    if not device.startswith("cuda"):
        yield
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.device(device))):
        yield


CGROUPS = (("memory.max", "memory.current"), ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"))
"""Files of a container's limit and use, of version 2 and 1, below `CGROUP` [bytes]."""
CGROUP, MEMINFO = Path("/sys/fs/cgroup"), Path("/proc/meminfo")


def free_memory(device: str) -> float:
    """Return how much memory can still be taken on a device [bytes]; infinite where the system does not tell."""
    if device != "cpu":
        cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
        return float(torch.cuda.mem_get_info(device)[0] + cached)
    free = 1e3 * 1.024 * _table(MEMINFO).get("MemAvailable:", math.inf)  # in units of 1024 bytes
    for limit, used in CGROUPS:
        with suppress(OSError, ValueError):  # another system, or no limit: "max"
            files = _table((CGROUP / used).with_name("memory.stat")).get("inactive_file", 0.0)
            free = min(free, int((CGROUP / limit).read_text()) - int((CGROUP / used).read_text()) + files)
    return free


def _table(path: Path) -> dict[str, float]:
    """Return the numbers of a file of lines of a name and a number."""
    try:
        rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
    except OSError:
        return {}
    return {row[0]: float(row[1]) for row in rows if len(row) > 1}


def ran_out_of_memory(error: BaseException) -> bool:
    """Whether an error of torch, Warp or numpy says that there was too little memory; torch's cache is then given back."""
    said = isinstance(error, RuntimeError) and any(text in str(error) for text in OUT_OF_MEMORY)
    if not (said or isinstance(error, MemoryError | torch.OutOfMemoryError)):
        return False
    if torch.cuda.is_initialized():
        torch.cuda.empty_cache()
    return True


OUT_OF_MEMORY = ("can't allocate memory", "Failed to allocate")
"""What torch says on the CPU, and Warp everywhere, in errors that have no class of their own."""
