"""Warp, made ready once and quietly: every module with a kernel imports `wp` from here.

Warp's own log level keeps its banner and its module lines back. One line does not obey it: the native library writes to
stderr that it found no CUDA driver, on every machine without one. That line alone is filtered out, during start-up only.
"""

import os
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import warp as wp

NO_DRIVER = "Could not find or load the NVIDIA CUDA driver"

__all__ = ["THREADS", "WarpStruct", "launch_in_threads", "wp"]

# A launch on the CPU holds one and releases the interpreter.
THREADS = 1 if os.environ.get("OMP_NUM_THREADS") == "1" else 2
PARTS = 4  # of a launch for each thread, so that none waits long for the others
SMALLEST_PART = 4  # items; fewer cost more in launching than they save

WarpStruct = Any  # an instance of a Warp struct: Warp makes no Python type that an annotation could name


def _start() -> None:
    if wp.config.log_level == wp.LOG_INFO:  # the default; a level that the user chose stays
        wp.config.log_level = wp.LOG_WARNING
    try:
        temporary = tempfile.TemporaryFile()  # noqa: SIM115 - the `with` below is for what comes after
    except OSError:  # no folder for temporary files has room: the line is seen
        wp.init()
        return
    with temporary as caught:
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        caught.seek(0)
        for line in caught.read().decode(errors="replace").splitlines():
            if NO_DRIVER not in line:
                print(line, file=sys.stderr)


def launch_in_threads(
    kernel: Any, dim: Sequence[int], inputs: Sequence[Any], *, device: str, threads: int = THREADS
) -> None:
    """Launch a kernel whose first input is where the first dimension begins, on the CPU in parts of that, by threads."""
    count, *others = dim
    parts = 1
    if wp.get_device(device).is_cpu:
        parts = max(1, min(threads * PARTS, count // SMALLEST_PART))
    bounds = [count * part // parts for part in range(parts + 1)]

    def launch(part: int) -> None:
        first, last = bounds[part], bounds[part + 1]
        wp.launch(kernel, dim=(last - first, *others), inputs=[first, *inputs], device=device)

    if parts == 1:
        launch(0)
        return
    wp.load_module(kernel.module, device=device)  # compiling is not safe from several threads
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(launch, range(parts)))


_start()
