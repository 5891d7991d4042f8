"""Where the command line writes its results: stdout."""

from rich.console import Console
from rich.table import Table

TABLE_WIDTH = 100  # columns when the output is a file or a pipe, so that tables do not depend on where they were made


def stdout() -> Console:
    """Console for results."""
    console = Console(highlight=False, markup=False)  # names of files and objects may hold brackets
    return console if console.is_terminal else Console(highlight=False, markup=False, width=TABLE_WIDTH)


def table(*columns: str) -> Table:
    """A table whose first column is text and whose others are numbers."""
    made = Table(header_style="bold")
    for index, column in enumerate(columns):
        made.add_column(column, justify="right" if index else "left", no_wrap=index == 0)
    return made
