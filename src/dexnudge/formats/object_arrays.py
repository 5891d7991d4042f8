"""NumPy files of dicts and lists (`.npy` with pickles), read so that nothing in them can run.

`numpy.load(allow_pickle=True)` calls whatever a file names, and NumPy's own unpickling trusts shapes and types so far that a
damaged file ends the process. Here a file may hold arrays of numbers and texts, dicts, lists, tuples, texts, numbers, truth
values and None, and arrays are put together and checked by this module alone.
"""

import math
import pickle
import re
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.lib import format as npy

from dexnudge.errors import InputError, quote, writing

LARGEST_FILE = 2**28  # [bytes] some 100,000 grasps
DEEPEST = 32  # levels of lists and dicts, and dimensions of arrays
MOST_VALUES = 2**24  # each counted as often as it stands there; 100,000 grasps at three moments have 9 million
SCALARS = (str, int, float, bool, type(None), np.number, np.bool_, np.str_)
CODE = re.compile(r"[<>|=]?(?:[biufcU]\d{1,7}|\?)")  # of types, as in NumPy's array protocol
EXPECTED = "expected the .npy file of a grasp tool, of arrays, dicts, lists, texts and numbers"


def read_object_array(path: Path) -> Any:
    """Return what a file that `numpy.save` wrote holds: a dict, a list of its entries, or an array; arrays are read-only.

    Raises:
        InputError: no such file, too large, damaged, or with anything in it that is no plain value.
    """
    try:
        _check_size(path)
        with path.open("rb") as file:
            major, _ = npy.read_magic(file)
            header = npy.read_array_header_1_0 if major == 1 else npy.read_array_header_2_0
            shape, _, dtype = header(file)
            if dtype.hasobject:
                content, _ = _plain(_Unpickler(file).load(), {})
            else:
                file.seek(0)
                content = npy.read_array(file, allow_pickle=False)
    except OSError as error:
        raise InputError(f"{path}: no such file, or it cannot be read; {EXPECTED}") from error
    except InputError:
        raise
    except Exception as error:
        # A damaged pickle raises whatever the calls that it makes raise; none of them is but what `_Unpickler` allows.
        raise InputError(f"{path} cannot be read ({type(error).__name__}: {error}); {EXPECTED}") from error
    if not isinstance(content, np.ndarray) or content.shape != shape:
        raise InputError(f"{path} is damaged: its header and its content differ; {EXPECTED}")
    return content.item() if content.shape == () else list(content) if content.dtype.hasobject else content


def write_object_array(path: Path, content: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Write a dict or a list of dicts as other tools do; OutputError where that fails."""
    array = np.empty(() if isinstance(content, dict) else len(content), dtype=object)
    array[...] = content
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, array, allow_pickle=True)


def _check_size(path: Path) -> None:
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path} is no file; {EXPECTED}")
    if found.st_size > LARGEST_FILE:
        raise InputError(f"{path} has {found.st_size >> 20} MiB; expected at most {LARGEST_FILE >> 20} MiB")


def _objects(values: list[Any]) -> np.ndarray:
    """Return an array of values that are what they are: numpy would make one of those that are arrays."""
    found = np.empty(len(values), dtype=object)
    for place, each in enumerate(values):
        found[place] = each
    return found


class _Type:
    """Stands for numpy.dtype."""

    def __init__(self, code: Any, *_: Any) -> None:
        self.is_object = code in ("O", "O8")
        if not self.is_object and not (isinstance(code, str) and CODE.fullmatch(code)):
            raise pickle.UnpicklingError(f"the type {quote(code)} is none of numbers and texts")
        self.dtype = np.dtype(object if self.is_object else code)

    def __setstate__(self, state: Any) -> None:
        order = state[1]
        if order not in ("<", ">", "|", "=") or any(part is not None for part in state[2:5]):
            raise pickle.UnpicklingError("a type has fields; expected numbers and texts")
        if order in ("<", ">"):
            self.dtype = self.dtype.newbyteorder(order)

    def array(self, raw: Any, shape: Any, order: str) -> Any:
        """Return raw bytes, or a list of values, as an array."""
        sizes = shape if isinstance(shape, tuple) and len(shape) <= DEEPEST else (-1,)
        if not all(type(each) is int and 0 <= each <= LARGEST_FILE for each in sizes):
            raise pickle.UnpicklingError(f"an array has the shape {quote(shape)}")
        if self.is_object:
            if not isinstance(raw, list) or len(raw) != math.prod(shape):
                raise pickle.UnpicklingError("an array of objects has more or fewer of them than its shape")
            return _objects(raw).reshape(shape, order="F" if order == "F" else "C")
        if not isinstance(raw, bytes | bytearray) or len(raw) != math.prod(shape) * self.dtype.itemsize:
            raise pickle.UnpicklingError("an array has more or fewer bytes than its shape")
        flat = np.frombuffer(bytes(raw), self.dtype)
        if self.dtype.kind == "U" and flat.size and self.dtype.itemsize:
            codes = flat.view(np.dtype(np.uint32).newbyteorder(self.dtype.byteorder))
            if codes.max() > sys.maxunicode:
                raise pickle.UnpicklingError("a text holds what is no character")
        return flat.reshape(shape, order="F" if order == "F" else "C")


class _Array:
    """Stands for numpy's `_reconstruct`, whose arguments say nothing, and for the array, which its state gives."""

    def __init__(self, *_: Any) -> None:
        self.value: Any = np.empty(0)

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, fortran, raw = state
        self.value = kind.array(raw, shape, "F" if fortran else "C")


class _Buffer:
    """Stands for numpy's `_frombuffer`."""

    def __new__(cls, raw: Any, kind: _Type, shape: Any, order: Any) -> Any:
        return kind.array(raw, shape, order)

    __setstate__ = None


class _Scalar:
    """Stands for numpy's `scalar`."""

    def __new__(cls, kind: _Type, raw: Any) -> Any:
        return kind.array(raw, (1,), "C")[0]

    __setstate__ = None


class _Never:
    """Stands for numpy.ndarray, which is named and never called."""

    def __new__(cls, *_: Any) -> Any:
        raise pickle.UnpicklingError("it asks for an array of a size alone")

    __setstate__ = None


ALLOWED: dict[tuple[str, str], type] = {
    ("numpy", "ndarray"): _Never,  # an argument of `_reconstruct`
    ("numpy", "dtype"): _Type,
    ("multiarray", "_reconstruct"): _Array,
    ("multiarray", "scalar"): _Scalar,
    ("numeric", "_frombuffer"): _Buffer,
}


# Written in Python: its memo grows by what is in it, and each opcode can be looked at.
PURE: Any = pickle._Unpickler  # noqa: SLF001 - public nowhere; the C one ends the process, or takes all memory


def _with_names(opcode: bytes, keys: slice) -> Callable[[Any], None]:
    """Return how an opcode puts entries into a dict, whose keys, at `keys` of the stack, must be texts."""
    load: Callable[[Any], None] = PURE.dispatch[opcode[0]]

    def checked(unpickler: Any) -> None:
        for key in unpickler.stack[keys]:
            if type(key) is not str:  # others may take for ever to hash
                raise pickle.UnpicklingError(f"a dict has a {type(key).__name__} as a key; expected texts")
        load(unpickler)

    return checked


def _refuse_set(_: Any) -> None:
    raise pickle.UnpicklingError("it holds a set")


class _Unpickler(PURE):
    """Makes only what `ALLOWED` names, each by a class of this module; dicts have texts as keys."""

    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = {
        **PURE.dispatch,
        pickle.SETITEM[0]: _with_names(pickle.SETITEM, slice(-2, -1)),
        pickle.SETITEMS[0]: _with_names(pickle.SETITEMS, slice(0, None, 2)),
        pickle.DICT[0]: _with_names(pickle.DICT, slice(0, None, 2)),
        pickle.BYTEARRAY8[0]: PURE.dispatch[pickle.BINBYTES8[0]],  # which does not make room before it reads
        **dict.fromkeys((pickle.EMPTY_SET[0], pickle.ADDITEMS[0], pickle.FROZENSET[0]), _refuse_set),
    }

    def find_class(self, module: str, name: str) -> Any:
        """Return the class of ours in place of what the file names; UnpicklingError for anything else."""
        short = re.sub(r"^numpy\._?core\.", "", module)
        if (short, name) not in ALLOWED:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which may run code")
        return ALLOWED[short, name]

    def persistent_load(self, pid: Any) -> Any:
        """Refuse what stands outside the file."""
        raise pickle.UnpicklingError(f"it asks for {quote(pid)}, which is not in it")


def _plain(value: Any, known: dict[int, Any], depth: int = 0) -> tuple[Any, int]:
    """Return a value with arrays in the place of `_Array`, made once, and how many values it is, however often they stand.

    Raises:
        UnpicklingError: a value of another kind, one that holds itself, or too many.
    """
    if isinstance(value, SCALARS):
        return value, 1
    if depth > DEEPEST:
        raise pickle.UnpicklingError(f"it is nested more than {DEEPEST} times")
    if id(value) not in known:
        made, count = _made_plain(value, known, depth + 1)
        if count > MOST_VALUES:
            raise pickle.UnpicklingError(f"it holds more than {MOST_VALUES} values")
        known[id(value)] = made, count, value  # which keeps the id its own
    made, count, _ = known[id(value)]
    return made, count


def _made_plain(value: Any, known: dict[int, Any], depth: int) -> tuple[Any, int]:
    if isinstance(value, _Array):
        value = value.value
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return value, 1 + value.size
    if type(value) not in (dict, list, tuple, np.ndarray):
        raise pickle.UnpicklingError(f"it holds a {type(value).__name__}")
    inside = value.values() if isinstance(value, dict) else value.ravel() if isinstance(value, np.ndarray) else value
    found = [_plain(each, known, depth) for each in inside]
    parts, count = [each for each, _ in found], 1 + sum(number for _, number in found)
    if isinstance(value, dict):
        return dict(zip(value, parts, strict=True)), count
    if isinstance(value, np.ndarray):
        return _objects(parts).reshape(value.shape), count
    return type(value)(parts), count
