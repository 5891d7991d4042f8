"""Warp, made ready once and quietly: every module with a kernel imports `wp` from here.

Warp's own log level keeps its banner and its module lines back. One line does not obey it: the native library writes to
stderr that it found no CUDA driver, on every machine without one. That line alone is filtered out, during start-up only.
"""

import os
import sys
import tempfile
from typing import Any

import warp as wp

NO_DRIVER = "Could not find or load the NVIDIA CUDA driver"

__all__ = ["WarpStruct", "wp"]

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


_start()
