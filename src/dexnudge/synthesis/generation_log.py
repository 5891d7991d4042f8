"""How a generation runs: a bar on the terminal, and `log.jsonl`, which is no part of the data."""

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rich.progress import Progress, TextColumn

from dexnudge.errors import OutputError
from dexnudge.jobs.progress import progress
from dexnudge.synthesis.object_task import ObjectOutcome

LOG_NAME = "log.jsonl"
TOP_REASONS = 3  # rejections that the bar names


class GenerationLog:
    """Counts what this start of a run has done; one line of JSON for each object, as it ends."""

    def __init__(self, folder: Path, bars: Progress, *, total: int, finished: int) -> None:
        self._path = folder / LOG_NAME
        self._bars = bars
        self._bar = bars.add_task("objects", total=total, completed=finished, summary="")
        self._start = time.monotonic()
        self.kept = self.attempted = self.failed_objects = 0
        self.rejected: Counter[str] = Counter()
        self._end_broken_line()

    def write(self, event: str, **content: Any) -> None:
        """Append a line; OutputError when the disk is full."""
        line = {"time": datetime.now(timezone.utc).isoformat(timespec="milliseconds"), "event": event, **content}
        self._append(json.dumps(line) + "\n")

    def tell(self, message: str) -> None:
        """Say something that the user should know now, above the bar, on stderr."""
        self._bars.console.print(message, style="yellow", soft_wrap=True)

    def add(self, name: str, outcome: ObjectOutcome) -> None:
        """Count one object."""
        kept = sum(count.kept for count in outcome.counts.values())
        self.kept += kept
        self.attempted += sum(count.attempted for count in outcome.counts.values())
        for count in outcome.counts.values():
            self.rejected.update(count.rejected)
        if outcome.failed:
            self.failed_objects += 1
            result: dict[str, Any] = {"failed": outcome.failed, **({"trace": outcome.trace} if outcome.trace else {})}
            self.tell(f"object {name} failed: {outcome.failed}")
        else:
            result = {"counts": {behaviour: asdict(count) for behaviour, count in sorted(outcome.counts.items())}}
        self._bars.update(self._bar, advance=1, summary=self.summary())
        self.write("object", name=name, seconds=round(outcome.seconds, 3), kept=kept, **result)

    def rate(self) -> float:
        """Kept configurations per second since this start."""
        return self.kept / max(time.monotonic() - self._start, 1e-9)

    def summary(self) -> str:
        """Rate, yield and the most frequent rejections in one line."""
        yielded = 100.0 * self.kept / self.attempted if self.attempted else 0.0
        reasons = [
            f"{reason} {100.0 * number / self.attempted:.0f} %"
            for reason, number in self.rejected.most_common(TOP_REASONS)
        ]
        rejections = f"; rejected: {', '.join(reasons)}" if reasons else ""
        return f"{self.rate():.1f} kept/s, yield {yielded:.1f} %{rejections}"

    def end(self, how: str) -> None:
        """The last line of this start."""
        self.write(
            "end",
            how=how,
            seconds=round(time.monotonic() - self._start, 3),
            kept=self.kept,
            attempted=self.attempted,
            kept_per_second=round(self.rate(), 3),
            failed_objects=self.failed_objects,
            rejected=dict(self.rejected.most_common()),
        )

    def _end_broken_line(self) -> None:
        """A writer that was killed may have left half a line."""
        if self._path.is_file() and not self._path.read_bytes().endswith(b"\n"):
            self._append("\n")

    def _append(self, text: str) -> None:
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise OutputError(f"cannot write {self._path}: {error}; expected a folder with free space.") from error


@contextmanager
def generation_log(folder: Path, *, total: int, finished: int) -> Iterator[GenerationLog]:
    """A log with its bar while the block runs; its last line says how the block ended."""
    with progress(TextColumn("{task.fields[summary]}")) as bars:
        log = GenerationLog(folder, bars, total=total, finished=finished)
        try:
            yield log
        except KeyboardInterrupt:
            log.end("interrupted")
            raise
        log.end("done")
