"""Every error that dexnudge raises on purpose.

A message says what happened, what was expected, what was found, and how to mend it. Each class is also the
builtin that a caller would catch. The command line prints the message and exits 2; anything else is a bug.
"""

import difflib
import math
import os
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from numbers import Integral
from pathlib import Path
from typing import Any

LONGEST_QUOTE = 80  # characters of a wrong value in a message
LONGEST_NAME = 1000  # characters of what a file calls a link, a joint or a digit
LONGEST_MESSAGE = 4000  # characters; of a longer one, beginning and end are shown
LONGEST_PART, LONGEST_PATH = 255, 4095  # bytes of a name and of a whole path that file systems take
LARGEST_SEED = 2**63 - 1


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return " (did you mean 'table'?)" for the known name that is most like `name`, or nothing."""
    close = difflib.get_close_matches(name, list(known), n=1) if isinstance(name, str) else []
    return f" (did you mean {close[0]!r}?)" if close else ""


def check_kind(argument: str, value: object, expected: type, example: str) -> None:
    """Refuse an argument of another class, such as a name in place of a hand; InputError."""
    if not isinstance(value, expected):
        given = repr(value) if isinstance(value, str) else f"a {type(value).__name__}"
        raise InputError(f"`{argument}` is {given}; expected a {expected.__name__}, such as {example}")


class _Repr(reprlib.Repr):
    """The beginning of a `repr`, however much a value holds; no more of it is made than a message shows."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 4
        self.maxlist = self.maxtuple = self.maxset = self.maxfrozenset = self.maxdict = LONGEST_QUOTE // 3 + 1
        self.maxstring = self.maxother = LONGEST_NAME  # cut in its middle, beyond what is shown

    def repr_int(self, value: int, _level: int) -> str:
        if abs(value) <= 10**LONGEST_QUOTE:
            return repr(value)
        digits = int(math.log10(abs(value)))  # or one more: the logarithm is rounded
        return f"an integer of {digits + (abs(value) >= 10**digits)} digits"


def quote(value: object) -> str:
    """Return a wrong value as messages show it: not longer than a line."""
    text = _Repr().repr(value)
    return text if len(text) <= LONGEST_QUOTE else f"{text[:LONGEST_QUOTE]}..."


def printable(text: str) -> str:
    """Return a text of which terminals show every character: others than line ends are escaped as Python does."""
    return "".join(each if each.isprintable() or each == "\n" else ascii(each)[1:-1] for each in text)


def printable_name(name: str) -> str:
    """Return the name of a file or folder in what every file and terminal can show, on one line; _ for the rest."""
    return "".join(each if each.isprintable() else "_" for each in name)


def is_name(value: object) -> bool:
    """Whether a value that a file holds can be a name: a text that is not empty, not endless, and printable."""
    return isinstance(value, str) and 0 < len(value) <= LONGEST_NAME and value.isprintable()


def shortened(message: str) -> str:
    """Return a message as a person reads it: of a long one, its beginning, and how to mend it at its end."""
    half = LONGEST_MESSAGE // 2
    return message if len(message) <= LONGEST_MESSAGE else f"{message[:half]} [...] {message[-half:]}"


def check_integer(argument: str, value: object, *, least: int, most: int | None = None) -> None:
    """Refuse what is no integer (True is none) or out of range; InputError."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or int(value) < least or (most is not None and int(value) > most):  # type: ignore[call-overload]
        kind = "" if whole else "an integer of "
        limit = f"at least {least}" if not whole or int(value) < least else f"at most {most}"  # type: ignore[call-overload]
        raise InputError(f"`{argument}` is {quote(value)}; expected {kind}{limit}")


def check_seed(seed: Any) -> None:
    """Refuse a seed that the generators of numpy and torch do not both take; InputError."""
    if isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= int(seed) <= LARGEST_SEED:
        raise InputError(f"`seed` is {quote(seed)}; expected a whole number from 0 to {LARGEST_SEED}")


def check_path(argument: str, value: object, error: Any = None) -> None:
    """Refuse what is no path of a file system: None, a text with a NUL, a name too long; `error`, or InputError."""
    text = str(value)
    parts = text.encode("utf-8", "surrogatepass").split(os.sep.encode())
    sizes = max(map(len, parts)), sum(map(len, parts)) + len(parts)
    if not isinstance(value, str | os.PathLike) or "\0" in text or sizes[0] > LONGEST_PART or sizes[1] > LONGEST_PATH:
        raise (error or InputError)(
            f"`{argument}` is {quote(value)}; expected the path of a file or folder, without NUL, each name of at most "
            f"{LONGEST_PART} bytes and all of at most {LONGEST_PATH}"
        )


def what_failed(error: OSError) -> str:
    """Return why a file or folder cannot be made, in words; a file in the place of a folder is named."""
    if isinstance(error, FileExistsError | NotADirectoryError):
        path = Path(error.filename)
        return f"{next(filter(Path.is_file, [path, *path.parents]), path)}: a file stands where a folder is needed"
    return error.strerror or str(error)


class DexnudgeError(Exception):
    """Base of every deliberate error."""


class InputError(DexnudgeError, ValueError):
    """Input that cannot be used as given."""


class MeshError(InputError):
    """A mesh that is missing, broken, empty, or of an implausible size."""


class HandError(InputError):
    """A hand description that is malformed or inconsistent."""


class ArmError(InputError):
    """An arm description that is malformed or inconsistent, or an arm that cannot stand or carry a hand as asked."""


class PlanningError(DexnudgeError):
    """No configuration has a plan; `failures` says which phase of each failed, and why."""

    def __init__(self, message: str, failures: tuple[Any, ...]) -> None:
        super().__init__(message)
        self.failures = failures


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


@contextmanager
def writing(
    what: object, remedy: str = "expected a folder that exists, is writable and has free space"
) -> Iterator[None]:
    """Let the block write `what`; OutputError where the disk refuses."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"cannot write {what}: {what_failed(error)}; {remedy}") from error
