"""JSON that others wrote: read without trust, and the files it names kept inside its folder."""

from __future__ import annotations

import json
import stat
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from dexnudge.errors import LARGEST_SEED, InputError, SceneError, quote

LARGEST_NUMBER = sys.float_info.max
MAX_BYTES = 32_000_000  # of a JSON file; read, it is at most some thirty times as large: lists of empty lists


def refuse_constant(text: str) -> float:
    """Refuse NaN and infinities of a JSON text; a `parse_constant`."""
    raise ValueError(f"{text} is not a JSON number")


def read_json(
    path: Path,
    *,
    error: type[InputError] = SceneError,
    expected: str = "a JSON file",
    again: str = "the file is truncated or damaged",
    constant: Callable[[str], float] = refuse_constant,
) -> Any:
    """Read a JSON file; `error` if it is missing, unreadable, malformed, or has a key twice, NaN or infinity in it.

    expected, again: what messages say of a missing file, and of how a damaged one is mended.
    constant: what becomes of NaN and infinities, `float` to take them.
    """
    try:
        found = path.stat()
        if not stat.S_ISDIR(found.st_mode) and (not stat.S_ISREG(found.st_mode) or found.st_size > MAX_BYTES):
            raise error(f"{path}: is no file, or larger than {MAX_BYTES / 1e6:.0f} MB; expected {expected}")
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=constant, object_pairs_hook=unique_keys)
    except (FileNotFoundError, IsADirectoryError) as cause:
        raise error(f"{path}: no such file; expected {expected}") from cause
    except (ValueError, OSError, RecursionError) as cause:
        if isinstance(cause, InputError):
            raise
        raise error(f"{path}: cannot be read as JSON ({cause}); {again}") from cause


def read_json_object(path: Path, *, error: type[InputError] = SceneError, **options: Any) -> dict[str, Any]:
    """Read the JSON object in a file, as `read_json`; `error` also if it holds anything else."""
    content = read_json(path, error=error, **options)
    if not isinstance(content, dict):
        raise error(f"{path}: holds a JSON {type(content).__name__}; expected an object with named values")
    return content


Checked = TypeVar("Checked")


def from_fields(content: Any, kind: type[Checked], where: str, *, error: type[InputError], again: str) -> Checked:
    """Return the dataclass `kind` made of a JSON object: every field is there or has a default, and is as it is declared.

    where, again: how messages begin and end. Raises `error`; what the dataclass itself refuses passes through.
    """
    if not isinstance(content, dict):
        raise error(f"{where} is {quote(content)}; expected an object with named values; {again}")
    declared, hints = fields(kind), get_type_hints(kind)  # type: ignore[arg-type]  # a dataclass
    required = {field.name for field in declared if field.default is field.default_factory is MISSING}
    wrong = sorted((required - content.keys()) | (content.keys() - {field.name for field in declared}))
    if wrong:
        what = "lacks" if wrong[0] in required else "has the unknown field"
        raise error(f"{where} {what} {quote(wrong[0])}; expected {', '.join(sorted(required))}; {again}")
    for name, value in content.items():
        if not _is_of(value, hints[name]):
            expected = (
                getattr(hints[name], "__name__", str(hints[name])) if get_origin(hints[name]) is None else hints[name]
            )
            raise error(f"{where}: {name} is {quote(value)}; expected {expected}; {again}")
    return kind(**{name: _frozen(value, hints[name]) for name, value in content.items()})


def _is_of(value: Any, hint: Any) -> bool:
    """Whether a JSON value is of a type: finite where a number, a list where a tuple."""
    origin, inside = get_origin(hint), get_args(hint)
    if hint in (Any, object):
        return True
    if origin in (Union, UnionType):
        return any(_is_of(value, each) for each in inside)
    if origin is Literal:
        return any(type(value) is type(each) and value == each for each in inside)
    if origin is dict:
        return isinstance(value, dict) and all(_is_of(each, inside[1]) for each in value.values())
    if origin is tuple:
        return isinstance(value, list | tuple) and all(_is_of(each, inside[0]) for each in value)
    if hint is float:
        return type(value) in (int, float) and -LARGEST_NUMBER <= value <= LARGEST_NUMBER
    if hint is int:
        return type(value) is int and abs(value) <= LARGEST_SEED
    return type(value) is (type(None) if hint is None else hint)


def _frozen(value: Any, hint: Any) -> Any:
    """Return JSON lists as the tuples that a type wants."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return _frozen(value, next(each for each in inside if _is_of(value, each)))
    if origin is tuple:
        return tuple(_frozen(each, inside[0]) for each in value)
    if origin is dict:
        return {key: _frozen(each, inside[1]) for key, each in value.items()}
    return value


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
