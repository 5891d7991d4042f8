"""The seconds that each stage of a long job has taken, over all of its starts, however these ended."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dexnudge.errors import OutputError
from dexnudge.jobs.folders import replace_atomically

EVERY = 5.0  # [s] between writes: what a kill can hide


class StageClock:
    """Counts the seconds of stages in a file.

    Attributes:
        seconds: of each stage so far, in the order in which they began.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.seconds: dict[str, float] = {}
        self._running: tuple[str, float] | None = None
        with suppress(OSError, ValueError):  # there is none yet, or a failing disk has lost what is no result
            self.seconds = {str(name): float(value) for name, value in json.loads(path.read_text("utf-8")).items()}

    @property
    def total(self) -> float:
        """Seconds of all stages until now."""
        self._count()
        return sum(self.seconds.values())

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the seconds of the block to a stage."""
        ended = threading.Event()
        self._running = (name, self.seconds.get(name, 0.0) - time.monotonic())

        self._count()

        def count() -> None:
            self._count()
            with replace_atomically(self._path) as temporary:
                temporary.write_text(json.dumps(self.seconds, indent=2) + "\n", encoding="utf-8")

        def count_on() -> None:
            while not ended.wait(EVERY):
                with suppress(OutputError):  # the stage itself says that the disk is full
                    count()

        counter = threading.Thread(target=count_on, daemon=True)
        counter.start()
        try:
            yield
        finally:
            ended.set()
            counter.join()
            with suppress(OutputError):
                count()
            self._running = None

    def _count(self) -> None:
        if self._running:
            name, before = self._running
            self.seconds[name] = before + time.monotonic()
