"""Standard output that may be closed, which is no failure, or full, which is one message."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper

from dexnudge.errors import OutputError


class Output(TextIOWrapper):
    """Text output that raises OutputError where it cannot be written, once: what follows goes nowhere.

    A pipe whose reader has ended is a BrokenPipeError, as ever.
    """

    def write(self, text: str) -> int:
        """Write a text."""
        with self._told():
            return super().write(text)

    def flush(self) -> None:
        """Write what waits to be written."""
        with self._told():
            super().flush()

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            raise
        except OSError as error:
            send_nowhere(self.fileno())
            raise OutputError(
                f"cannot write to standard output: {error.strerror}; expected a terminal, a pipe, or a file on a disk with "
                "free space; what was not told of may be written all the same"
            ) from error


def send_nowhere(descriptor: int) -> None:
    """Have what is still written to a descriptor, such as by Python at its end, be dropped."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def open_streams() -> None:
    """Open standard streams that the caller closed, to nowhere, and have stdout say where it cannot be written.

    Else the next file that is opened would take the number of the closed one, and what libraries print with it.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the least number that is free
    sys.stdout, sys.stderr = (each or open(os.devnull, "w") for each in (sys.stdout, sys.stderr))  # noqa: PTH123, SIM115
    if type(sys.stdout) is TextIOWrapper:
        settings = {
            name: getattr(sys.stdout, name) for name in ("encoding", "errors", "line_buffering", "write_through")
        }
        sys.stdout = Output(sys.stdout.detach(), **settings)
