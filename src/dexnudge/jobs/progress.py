"""Progress bars, the same everywhere; where nobody sees them, a line now and then."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from dexnudge.errors import printable

LINES_APART = 30.0  # [s] at least: a log of a day stays readable, and a short job says nothing


class ProgressLines(Progress):
    """Lines such as "objects: 3 of 8" on the console, each at least `LINES_APART` after the start and the one before."""

    def __init__(self, *columns: ProgressColumn, **options: Any) -> None:
        super().__init__(*columns, disable=True, **options)
        self._last = self.get_time()

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Change a task as a bar's is, and print its line when one is due; none of what has not begun or is done."""
        super().update(task_id, **changes)
        task, now = self._tasks[task_id], self.get_time()
        if now - self._last >= LINES_APART and task.visible and task.completed and not task.finished:
            self._last = now
            total = "" if task.total is None else f" of {task.total:.0f}"
            self.console.print(f"{printable(task.description)}: {task.completed:.0f}{total}", soft_wrap=True)


@contextmanager
def progress(*further: ProgressColumn) -> Iterator[Progress]:
    """Bars on stderr while the block runs, with `further` columns behind the time; lines when stderr is no terminal."""
    console = Console(stderr=True, highlight=False, markup=False)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        *further,
    )
    if not console.is_terminal:
        yield ProgressLines(*columns, console=console)
        return
    with Progress(*columns, console=console, transient=True) as bars:
        yield bars
