"""JSON that others wrote: read without trust, and the files it names kept inside its folder."""

from __future__ import annotations

import json
import stat
import sys
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import EnumMeta
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from dexnudge.errors import LARGEST_SEED, InputError, SceneError, did_you_mean, is_name, quote

LARGEST_NUMBER = sys.float_info.max
MAX_BYTES = 1_000_000  # of a pose, a scene, settings; read, they are at most some thirty times as large: empty lists
MAX_TABLE_BYTES = 32_000_000  # of what lists objects, draws or tasks


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
    largest: int = MAX_BYTES,
) -> Any:
    """Read a JSON file; `error` if it is missing, unreadable, malformed, or has a key twice, NaN or infinity in it.

    expected, again: what messages say of a missing file, and of how a damaged one is mended.
    constant: what becomes of NaN and infinities, `float` to take them. largest: [bytes].
    """
    try:
        found = path.stat()
        if not stat.S_ISDIR(found.st_mode) and (not stat.S_ISREG(found.st_mode) or found.st_size > largest):
            raise error(f"{path}: is no file, or larger than {largest / 1e6:.0f} MB; expected {expected}")
        text = path.read_text(encoding="utf-8-sig")  # Windows' editors put a mark before it
        return json.loads(text, parse_constant=constant, object_pairs_hook=unique_keys)
    except (FileNotFoundError, IsADirectoryError) as cause:
        raise error(f"{path}: no such file; expected {expected}") from cause
    except UnicodeDecodeError as cause:
        raise error(f"{path}: cannot be read as JSON (it is not UTF-8); save it as UTF-8") from cause
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


@dataclass(frozen=True)
class Must:
    """What a value must be beside its type, in `Annotated`: `words` say it in messages, `be` tells whether a value is."""

    words: str
    be: Callable[[Any], object]


AT_LEAST_0 = Must("at least 0", lambda number: number >= 0)
Name = Annotated[str, Must("a name", is_name)]


def from_fields(
    content: Any, kind: type[Checked], where: str, *, error: type[InputError], again: str, others: bool = False
) -> Checked:
    """Return the dataclass `kind` made of a JSON object: every field is there or has a default, and is as it is declared.

    A field is of JSON's types, tuples in place of lists, an Enum, another dataclass, or `Annotated` with a `Must` or with
    a function of the value and of its place, which returns what it stands for.

    where, again: how messages begin and end. others: whether there may be more than the fields. Raises `error`; what the
    dataclass itself, or a function, refuses passes through.
    """
    if not isinstance(content, dict):
        raise error(f"{where} is {quote(content)}; expected an object with named values; {again}")
    declared, hints = fields(kind), _hints(kind)  # type: ignore[arg-type]  # a dataclass
    required = [field.name for field in declared if field.default is field.default_factory is MISSING]
    if missing := [name for name in required if name not in content]:
        raise error(f"{where} lacks {', '.join(missing)}; expected {', '.join(required)}; {again}")
    known = [field.name for field in declared]
    if unknown := [name for name in content if name not in known and not others]:
        meant = did_you_mean(unknown[0], known)
        raise error(f"{where} has the unknown field {quote(unknown[0])}{meant}; expected {', '.join(known)}; {again}")
    says: dict[str, Any] = {"error": error, "again": again, "others": others}
    return kind(
        **{name: _read(content[name], hints[name], f"{where}: {name}", says) for name in known if name in content}
    )


@cache
def _hints(kind: type[object]) -> dict[str, Any]:
    """Return the types of a dataclass's fields, found once: a file may hold a hundred thousand of them."""
    return get_type_hints(kind, include_extras=True)


def _read(value: Any, hint: Any, where: str, says: dict[str, Any]) -> Any:
    """Return what a JSON value stands for as a type, see `from_fields`."""
    origin, inside = get_origin(hint), get_args(hint)
    if hint in (Any, object):
        return value
    if is_dataclass(hint):
        return from_fields(value, hint, where, **says)  # type: ignore[arg-type]  # a class
    if origin in (Union, UnionType):  # of one type and None
        return None if value is None else _read(value, inside[0], where, says)
    if origin is dict and isinstance(value, dict):
        return {key: _read(each, inside[1], f"{where} of {quote(key)}", says) for key, each in value.items()}
    if origin in (tuple, list) and isinstance(value, list | tuple):
        return origin(_read(each, inside[0], f"{where}[{index}]", says) for index, each in enumerate(value))
    if isinstance(hint, EnumMeta):
        known: list[Any] = list(hint)
        return hint(_read(value, Literal[tuple(each.value for each in known)], where, says))
    if origin is Annotated and not isinstance(inside[1], Must):
        return inside[1](value, where)
    if origin is Annotated and _is_of(value, inside[0]) and inside[1].be(value):
        return _read(value, inside[0], where, says)
    if origin is Annotated or not _is_of(value, hint):
        raise says["error"](f"{where} is {quote(value)}; expected {_words(hint)}; {says['again']}")
    return float(value) if hint is float else value


def _is_of(value: Any, hint: Any) -> bool:
    """Whether a JSON value is of a type: finite where a number; of lists and objects, whether it is one."""
    kind = get_origin(hint) or hint
    if kind is Literal:
        return any(type(value) is type(each) and value == each for each in get_args(hint))
    if kind is float:
        return type(value) in (int, float) and -LARGEST_NUMBER <= value <= LARGEST_NUMBER
    if kind is int:
        return type(value) is int and abs(value) <= LARGEST_SEED
    return type(value) in ((list, tuple) if kind is tuple else (kind,))


def _words(hint: Any) -> str:
    """Return what messages call a type."""
    if get_origin(hint) is Annotated:
        return str(get_args(hint)[1].words)
    if get_origin(hint) is Literal:
        return " or ".join(map(repr, get_args(hint)))
    words = {str: "a text", int: "a whole number", float: "a finite number", bool: "true or false", dict: "an object"}
    return words.get(get_origin(hint) or hint, "a list")


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
