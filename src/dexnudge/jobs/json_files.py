"""JSON that others wrote: read without trust, and the files it names kept inside its folder."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError, SceneError, quote

MAX_BYTES = 100_000_000  # of a JSON file; read, it is some ten times as large


def read_json(
    path: Path,
    *,
    error: type[InputError] = SceneError,
    expected: str = "a JSON file",
    again: str = "the file is truncated or damaged",
) -> Any:
    """Read a JSON file; `error` if it is missing, unreadable, malformed, or has a key twice, NaN or infinity in it.

    expected, again: what messages say of a missing file, and of how a damaged one is mended.
    """
    try:
        found = path.stat()
        if not stat.S_ISDIR(found.st_mode) and (not stat.S_ISREG(found.st_mode) or found.st_size > MAX_BYTES):
            raise error(f"{path}: is no file, or larger than {MAX_BYTES / 1e6:.0f} MB; expected {expected}")
        return json.loads(
            path.read_text(encoding="utf-8"), parse_constant=_refuse_constant, object_pairs_hook=unique_keys
        )
    except (FileNotFoundError, IsADirectoryError) as cause:
        raise error(f"{path}: no such file; expected {expected}") from cause
    except (ValueError, OSError, RecursionError) as cause:
        if isinstance(cause, InputError):
            raise
        raise error(f"{path}: cannot be read as JSON ({cause}); {again}") from cause


def read_json_object(path: Path, *, error: type[InputError] = SceneError, **messages: str) -> dict[str, Any]:
    """Read the JSON object in a file, as `read_json`; `error` also if it holds anything else."""
    content = read_json(path, error=error, **messages)
    if not isinstance(content, dict):
        raise error(f"{path}: holds a JSON {type(content).__name__}; expected an object with named values")
    return content


def path_inside(folder: Path, value: Any, key: str, *, file: str, what: str) -> Path:
    """Return the path of `what`, which `key` of `file` names, below `folder`.

    Raises:
        SceneError: not a path, or it points anywhere else, also through a link.
    """
    if not isinstance(value, str) or not value or "\0" in value:
        raise SceneError(f"{key} is {value!r}; expected a path relative to the folder of {file}")
    try:
        target = (folder / value).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise SceneError(
            f"{key} is {value!r}, which is no path ({error}); expected one in the folder of {file}"
        ) from error
    if Path(value).is_absolute() or "\\" in value or not target.is_relative_to(folder.resolve()):
        raise SceneError(
            f"{key} is {value!r}, outside the folder of {file}; expected a relative path inside it; "
            f"copy the {what} into the folder"
        )
    return target


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the object of a JSON text; an `object_pairs_hook`.

    Raises:
        ValueError: a key stands twice, of which readers keep one or the other.
    """
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {quote(key)} stands twice in an object; expected it once")
        found[key] = value
    return found


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a JSON number")
