"""Where the command line writes: results to stdout, progress to stderr."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

TABLE_WIDTH = 100  # columns when the output is a file or a pipe, so that tables do not depend on where they were made


def stdout() -> Console:
    """Console for results."""
    console = Console(highlight=False, markup=False)  # names of files and objects may hold brackets
    return console if console.is_terminal else Console(highlight=False, markup=False, width=TABLE_WIDTH)


@contextmanager
def progress() -> Iterator[Progress]:
    """Bars on stderr while the block runs; nothing when stderr is no terminal."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    bars = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    if bars.disable:
        yield bars
        return
    with bars:
        yield bars


def table(*columns: str) -> Table:
    """A table whose first column is text and whose others are numbers."""
    made = Table(header_style="bold")
    for index, column in enumerate(columns):
        made.add_column(column, justify="right" if index else "left", no_wrap=index == 0)
    return made
