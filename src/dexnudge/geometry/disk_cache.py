"""Arrays that are costly to make, kept on disk so that the same one is made only once.

An array lies in the user's cache folder as a .npy file (no pickle), named by the SHA-256 of all that its values depend
on, and followed by the SHA-256 of name and bytes. What is not such a file, or not whole, is made again and replaced. A
cache that cannot be read or written changes nothing but the time. Environment variables: XDG_CACHE_HOME moves the folder,
DEXNUDGE_CACHE names it by an absolute path, or is `off`: it is left alone.
"""

import contextlib
import hashlib
import io
import os
import re
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

SWITCH, OFF = "DEXNUDGE_CACHE", "off"
LARGEST_CACHE = 1_000_000_000  # [bytes] of the folder: some 500 objects the size of a phone
OURS = re.compile(r"[0-9a-f]{64}.*\.(npy|part)")  # names of files in the folder, which may hold others
DIGEST = hashlib.sha256().digest_size


def cached_array(
    kind: str, inputs: Sequence[Shaped[np.ndarray, "..."]], make: Callable[[], Shaped[np.ndarray, "..."]]
) -> Shaped[np.ndarray, "..."]:
    """Return what `make` makes of some arrays, read from the cache if it is there.

    Args:
        kind: what is made, and by which version of what; another text for other values from the same inputs.
        inputs: all that the values depend on; shapes, types and every bit are part of the key.
        make: called where the cache has no such array.
    """
    folder = cache_folder()
    if folder is None:
        return make()
    file = folder / f"{_key(kind, inputs)}.npy"
    values = _read(file)
    if values is None:
        values = make()
        _write(file, values)
    return values


def cache_folder() -> Path | None:
    """Return where arrays are kept; None where the user wants no cache or has no home."""
    given = os.environ.get(SWITCH, "")
    if given.lower() == OFF:
        return None
    if Path(given).is_absolute():
        return Path(given)
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # unset, empty or relative: the XDG specification ignores it
        try:
            base = Path.home() / ".cache"
        except RuntimeError:
            return None
    return base / "dexnudge" / "grids"


def _key(kind: str, inputs: Sequence[Shaped[np.ndarray, "..."]]) -> str:
    key = hashlib.sha256(f"{kind} {[(array.dtype.str, array.shape) for array in inputs]}".encode())
    for array in inputs:
        key.update(np.ascontiguousarray(array).tobytes())
    return key.hexdigest()


def _read(file: Path) -> Shaped[np.ndarray, "..."] | None:
    """Return the array in a file; None where there is no such file or it is not one of ours, whole."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    if _digest(file, memoryview(content)[:-DIGEST]) != content[-DIGEST:]:
        return None
    with contextlib.suppress(OSError):  # another's folder
        os.utime(file)  # what was used last is deleted last
    values: np.ndarray = np.load(io.BytesIO(content), allow_pickle=False)  # stops where the array ends
    return values


def _write(file: Path, values: Shaped[np.ndarray, "..."]) -> None:
    """Put a file in its place in one step, so that no other process finds half of it; do without where that fails."""
    content = io.BytesIO()
    np.save(content, values, allow_pickle=False)
    array = content.getvalue()
    with contextlib.suppress(OSError):  # read-only home, full disk: the next run makes the array again
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=file.parent, prefix=file.stem, suffix=".part")
        part = Path(name)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(array + _digest(file, array))
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)
        _make_room(file.parent)


def _digest(file: Path, array: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(file.stem.encode())
    digest.update(array)
    return digest.digest()


def _make_room(folder: Path) -> None:
    """Delete the arrays that have been unused for longest, until all are within the limit; what else lies there stays."""
    found = {file: file.stat() for file in folder.iterdir() if OURS.fullmatch(file.name)}
    total = sum(each.st_size for each in found.values())
    for file in sorted(found, key=lambda file: found[file].st_mtime_ns):
        if total <= LARGEST_CACHE:
            return
        file.unlink(missing_ok=True)
        total -= found[file].st_size
