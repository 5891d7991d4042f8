"""Where tensors and Warp arrays lie and kernels run: on the CPU, or on one CUDA device of this machine.

What takes a `device` runs the same code on each. Random numbers are drawn on the CPU and copied, so that a seed means the
same draws everywhere, up to rounding.
"""

import errno
import math
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

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


_computed: set[int] = set()  # processes that have computed in threads of torch: this one, and those it was forked from


@contextmanager
def own_modes() -> Iterator[None]:
    """Let torch compute as it does unless told otherwise, whatever modes and defaults the caller has set.

    That is: with gradients, float32 where no type is given, on the CPU where no device is, and without autocast. The default
    type is the whole process's; it is the caller's again in the end.

    Raises:
        InputError: in a process that was forked from one that has computed: threads do not survive a fork, and torch would
            wait for its own without end.
    """
    if torch.get_num_threads() > 1:
        if _computed - {os.getpid()}:
            raise InputError(
                "this process was forked from one in which torch has computed in threads, and no fork copies those; "
                'expected one that stands alone; start it with multiprocessing.get_context("spawn"), or call '
                "torch.set_num_threads(1) in it first"
            )
        _computed.add(os.getpid())
    own_type = torch.get_default_dtype()
    with ExitStack() as modes:
        for mode in (torch.inference_mode(mode=False), torch.enable_grad(), torch.autocast("cpu", enabled=False)):
            modes.enter_context(mode)
        if torch.is_autocast_enabled("cuda"):
            modes.enter_context(torch.autocast("cuda", enabled=False))
        if torch.get_default_device().type != "cpu":  # a mode that takes time in each call of torch
            modes.enter_context(torch.device("cpu"))
        if own_type != torch.float32:
            modes.callback(torch.set_default_dtype, own_type)
            torch.set_default_dtype(torch.float32)
        yield


def torch_stream(device: str) -> AbstractContextManager[Any]:
    """Have Warp work on torch's current stream of a CUDA device while the block runs: neither overtakes the other."""
    return wp.ScopedStream(wp.stream_from_torch(torch.device(device))) if device.startswith("cuda") else nullcontext()


CGROUPS = (("memory.max", "memory.current"), ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"))
"""Files of a container's limit and use, of version 2 and 1, below `CGROUP` [bytes]."""
CGROUP, MEMINFO, STATUS = Path("/sys/fs/cgroup"), Path("/proc/meminfo"), Path("/proc/self/status")


def free_memory(device: str) -> float:
    """Return how much memory can still be taken on a device [bytes]; infinite where the system does not tell."""
    if device != "cpu":
        cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
        return float(torch.cuda.mem_get_info(device)[0] + cached)
    free = 1e3 * 1.024 * _table(MEMINFO).get("MemAvailable:", math.inf)  # in units of 1024 bytes
    if find_spec("resource"):  # not Windows
        import resource

        if (most := resource.getrlimit(resource.RLIMIT_AS)[0]) >= 0:
            free = min(free, most - 1e3 * 1.024 * _table(STATUS).get("VmSize:", 0.0))
    for limit, used in CGROUPS:
        with suppress(OSError, ValueError):  # another system, or no limit: "max"
            files = _table((CGROUP / used).with_name("memory.stat")).get("inactive_file", 0.0)
            free = min(free, int((CGROUP / limit).read_text()) - int((CGROUP / used).read_text()) + files)
    return free


def _table(path: Path) -> dict[str, float]:
    """Return the numbers of a file of lines of a name and a number; of others, nothing."""
    try:
        rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
    except OSError:
        return {}
    return {row[0]: float(row[1]) for row in rows if len(row) > 1 and row[1].isdecimal()}


def ran_out_of_memory(error: BaseException) -> bool:
    """Whether an error of torch, Warp or numpy says that there was too little memory; torch's cache is then given back."""
    said = isinstance(error, RuntimeError) and any(text in str(error) for text in OUT_OF_MEMORY)
    said |= isinstance(error, OSError) and error.errno == errno.ENOMEM
    if not (said or isinstance(error, MemoryError | torch.OutOfMemoryError)):
        return False
    if torch.cuda.is_initialized():
        torch.cuda.empty_cache()
    return True


OUT_OF_MEMORY = ("can't allocate memory", "Failed to allocate", "can't start new thread")
"""What torch says on the CPU, Warp everywhere, and Python, in errors that have no class of their own."""
