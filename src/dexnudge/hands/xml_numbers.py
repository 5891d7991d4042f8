"""Numbers written so that reading them gives the same numbers."""

from collections.abc import Iterable


def numbers(values: Iterable[float]) -> str:
    """The shortest text of each value that reads back exactly, separated by spaces."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # + 0.0 turns -0.0 into 0.0
