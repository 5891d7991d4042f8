"""Tables as markdown text."""

from collections.abc import Sequence
from typing import Any


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[Any]], *, names: int = 2) -> str:
    """A table whose first `names` columns are text, and the others numbers."""
    marks = ["---"] * names + ["---:"] * (len(header) - names)
    return "\n".join("| " + " | ".join(map(str, cells)) + " |" for cells in [header, marks, *rows])


def number(value: float | None, digits: int = 2) -> str:
    """A number as text; empty where there is none."""
    return "" if value is None else f"{value:.{digits}f}"
