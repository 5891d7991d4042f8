"""npz archives that others wrote: read without trust, and no more of them than they announce."""

import math
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path

import numpy as np

from dexnudge.errors import LONGEST_QUOTE, InputError

LARGEST = 2**30  # [bytes] unpacked: some million draws; more is no result
NPY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
DAMAGE = (
    OSError,
    ValueError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    RuntimeError,  # an unknown compression, a password, or a header with too many brackets
    MemoryError,  # the same, and no lack of memory
    SyntaxError,
    tokenize.TokenError,
)
"""What reading an archive that numpy.savez did not write may raise."""


def read_arrays(
    path: Path, *, folder: str, content: str, largest: int = LARGEST, only: Collection[str] | None = None
) -> dict[str, np.ndarray]:
    """Return the arrays of an npz archive; no more is read into memory than its table of contents and headers allow.

    folder, content: what messages expect where the file is missing, and in it. largest: unpacked [bytes]. only: names of the
    arrays that are read; None: all.

    Raises:
        InputError: the file is missing or damaged; an entry is no array, is there twice, or is larger than a result can be.
    """
    if not path.is_file():
        raise InputError(f"{path} is missing; expected {folder}")
    try:
        return _read_arrays(path, largest, only)
    except InputError:
        raise
    except DAMAGE as error:
        raise InputError(f"{path} is damaged ({error}); expected {content}") from error


def _read_arrays(path: Path, largest: int, only: Collection[str] | None) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        size = sum(entry.file_size for entry in entries)
        if size > largest:
            raise InputError(f"{path} unpacks to {size / 2**20:.0f} MiB; expected at most {largest >> 20} MiB")
        for entry in entries:
            key, shown = entry.filename.removesuffix(".npy"), repr(entry.filename[:LONGEST_QUOTE])
            if only is not None and key not in only:
                continue
            if key in arrays:
                raise InputError(f"{path} holds {shown} twice; expected one array of each name")
            if key == entry.filename:
                raise InputError(f"{path} holds {shown}, which is no array; expected arrays only")
            arrays[key] = _read_array(archive, entry)
    return arrays


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """Return the array of an entry; ValueError where its header announces anything but what follows."""
    with archive.open(entry) as file:
        read_header = NPY_HEADERS.get(np.lib.format.read_magic(file))
        if read_header is None:
            raise ValueError("an array is written in an unknown version of the npy format")
        shape, _, dtype = read_header(file)
        if dtype.hasobject:
            raise ValueError("an array holds pickled objects")
        announced, size = math.prod(shape) * dtype.itemsize, entry.file_size - file.tell()
        if not dtype.itemsize or announced != size:
            raise ValueError(f"the header of an array announces {announced} bytes, and {size} follow")
        file.seek(0)
        array: np.ndarray = np.lib.format.read_array(file, allow_pickle=False)
    if dtype.kind == "U":
        codes = array.reshape(-1).view(np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if codes.max(initial=0) > sys.maxunicode:
            raise ValueError("a text holds what is no character")
    return array
