"""Progress bars, the same everywhere."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def progress(*further: ProgressColumn) -> Iterator[Progress]:
    """Bars on stderr while the block runs, with `further` columns behind the time; none when stderr is no terminal."""
    console = Console(stderr=True, highlight=False, markup=False)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        *further,
    )
    bars = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    if bars.disable:
        yield bars
        return
    with bars:
        yield bars
