"""Runs a Warp CPU kernel on all cores: Warp itself uses one thread for a launch on the CPU."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from dexnudge.geometry.warp_runtime import wp

BANDS_PER_WORKER = 8  # so that workers that drew cheap rows help with the costly ones
SMALLEST_BAND = 4096  # below this the threads cost more than they bring


def available_cores() -> int:
    """Cores that this process may use, which in a container are fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def parallel_launch(kernel: wp.Kernel, count: int, arguments: Sequence[Any]) -> None:
    """Launches `kernel` over `count` items in bands; its first parameter must be the index of the band's first item.

    Every item must write only its own outputs; then the result does not depend on the number of cores.
    """
    workers = available_cores()
    band = max(SMALLEST_BAND, -(-count // (workers * BANDS_PER_WORKER)))

    def launch(first: int) -> None:
        wp.launch(kernel, dim=min(band, count - first), inputs=[first, *arguments], device="cpu")

    launch(0)  # alone: the first launch compiles and loads the kernel, which threads must not do at the same time
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(launch, range(band, count, band)))
