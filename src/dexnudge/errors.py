"""Every error that dexnudge raises on purpose.

A message says what happened, what was expected, what was found, and how to mend it. Each class is also the
builtin that a caller would catch. The command line prints the message and exits 2; anything else is a bug.
"""

import difflib
from collections.abc import Iterable
from numbers import Integral
from typing import Any

LARGEST_SEED = 2**63 - 1


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return " (did you mean 'table'?)" for the known name that is most like `name`, or nothing."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def check_kind(argument: str, value: object, expected: type, example: str) -> None:
    """Refuse an argument of another class, such as a name in place of a hand; InputError."""
    if not isinstance(value, expected):
        given = repr(value) if isinstance(value, str) else f"a {type(value).__name__}"
        raise InputError(f"`{argument}` is {given}; expected a {expected.__name__}, such as {example}")


def check_seed(seed: Any) -> None:
    """Refuse a seed that the generators of numpy and torch do not both take; InputError."""
    if not isinstance(seed, Integral) or not 0 <= int(seed) <= LARGEST_SEED:
        raise InputError(f"`seed` is {seed!r}; expected a whole number from 0 to {LARGEST_SEED}")


class DexnudgeError(Exception):
    """Base of every deliberate error."""


class InputError(DexnudgeError, ValueError):
    """Input that cannot be used as given."""


class MeshError(InputError):
    """A mesh that is missing, broken, empty, or of an implausible size."""


class HandError(InputError):
    """A hand description that is malformed or inconsistent."""


class SceneError(InputError):
    """A scene that is physically or geometrically impossible."""


class CheckpointError(InputError):
    """Model weights that are truncated, foreign, or made for another hand."""


class DatasetError(InputError):
    """A dataset shard or manifest that is truncated, foreign, or of another version."""


class UnknownNameError(InputError, KeyError):
    """A name that is not in a table; the message lists the names that are."""

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError would print the repr, with quotes and escapes


class OutputError(DexnudgeError, OSError):
    """An output folder or file that cannot be written."""
