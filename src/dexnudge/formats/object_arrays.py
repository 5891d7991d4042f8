"""NumPy files of dicts and lists (`.npy` with pickles), read so that nothing in them can run.

`numpy.load(allow_pickle=True)` calls whatever a file names, and NumPy's own unpickling trusts shapes and types so far that a
damaged file ends the process. Here a file may hold arrays of numbers and texts, dicts, lists, tuples, texts, numbers, truth
values and None, and arrays are put together and checked by this module alone.
"""

import math
import pickle
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from dexnudge.errors import InputError, writing

LARGEST_FILE = 2**28  # [bytes] some 100,000 grasps
DEEPEST = 32  # levels of lists and dicts
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
                content = _plain(_Unpickler(file).load(), {})
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
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise InputError(f"{path} has {size >> 20} MiB; expected at most {LARGEST_FILE >> 20} MiB")


class _Type:
    """Stands for numpy.dtype."""

    def __init__(self, code: Any, *_: Any) -> None:
        self.is_object = code in ("O", "O8")
        if not self.is_object and not (isinstance(code, str) and CODE.fullmatch(code)):
            raise pickle.UnpicklingError(f"the type {code!r} is none of numbers and texts")
        self.dtype = np.dtype(object if self.is_object else code)

    def __setstate__(self, state: Any) -> None:
        order = state[1]
        if order not in ("<", ">", "|", "=") or any(part is not None for part in state[2:5]):
            raise pickle.UnpicklingError("a type has fields; expected numbers and texts")
        if order in ("<", ">"):
            self.dtype = self.dtype.newbyteorder(order)

    def array(self, raw: Any, shape: Any, order: str) -> Any:
        """Return raw bytes, or a list of values, as an array."""
        if not isinstance(shape, tuple) or not all(type(each) is int and each >= 0 for each in shape):
            raise pickle.UnpicklingError(f"an array has the shape {shape!r}")
        if self.is_object:
            if not isinstance(raw, list) or len(raw) != math.prod(shape):
                raise pickle.UnpicklingError("an array of objects has more or fewer of them than its shape")
            found = np.empty(len(raw), dtype=object)
            found[:] = raw
            return found.reshape(shape, order="F" if order == "F" else "C")
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


class _Unpickler(pickle.Unpickler):
    """Makes only what `ALLOWED` names, each by a class of this module."""

    def find_class(self, module: str, name: str) -> Any:
        """Return the class of ours in place of what the file names; UnpicklingError for anything else."""
        short = re.sub(r"^numpy\._?core\.", "", module)
        if (short, name) not in ALLOWED:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which may run code")
        return ALLOWED[short, name]

    def persistent_load(self, pid: Any) -> Any:
        """Refuse what stands outside the file."""
        raise pickle.UnpicklingError(f"it asks for {pid!r}, which is not in it")


def _plain(value: Any, known: dict[int, Any], depth: int = 0) -> Any:
    """Return a value with arrays in the place of `_Array`; each once, however often it stands there.

    Raises:
        UnpicklingError: a value of another kind, or one that holds itself.
    """
    if isinstance(value, SCALARS):
        return value
    if depth > DEEPEST:
        raise pickle.UnpicklingError(f"it is nested more than {DEEPEST} times")
    if id(value) not in known:
        known[id(value)] = _made_plain(value, known, depth + 1), value  # which keeps the id its own
    return known[id(value)][0]


def _made_plain(value: Any, known: dict[int, Any], depth: int) -> Any:
    if isinstance(value, _Array):
        value = value.value
    if isinstance(value, np.ndarray):
        if not value.dtype.hasobject:
            return value
        found = np.empty(value.size, dtype=object)
        for place, each in enumerate(value.ravel()):
            found[place] = _plain(each, known, depth)
        return found.reshape(value.shape)
    if type(value) is dict:
        return {_plain(key, known, depth): _plain(each, known, depth) for key, each in value.items()}
    if type(value) in (list, tuple):
        return type(value)(_plain(each, known, depth) for each in value)
    raise pickle.UnpicklingError(f"it holds a {type(value).__name__}")
