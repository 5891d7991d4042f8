"""Distance grids of objects kept on disk, so that the same one is built only once.

A grid lies in the user's cache folder as a .npy file (float32, no pickle), named by the SHA-256 of all that its values
depend on, and followed by the SHA-256 of name and bytes. What is not such a file, or not whole, is built again and
replaced. A cache that cannot be read or written changes nothing but the time. Environment variables: XDG_CACHE_HOME moves
the folder, DEXNUDGE_CACHE=off leaves it alone.
"""

import contextlib
import hashlib
import io
import os
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.distance_grid import DistanceGrid, distance_grid, grid_box
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.warp_runtime import wp

SWITCH, OFF = "DEXNUDGE_CACHE", "off"
FORMAT = b"dexnudge distance grid 1"  # another number for other bytes in the file, or other values for the same mesh
LARGEST_CACHE = 1_000_000_000  # [bytes] of the folder: some 500 objects the size of a phone
DIGEST = hashlib.sha256().digest_size


def cached_distance_grid(
    mesh: trimesh.Trimesh,
    lower: Float[np.ndarray, " 3"],
    upper: Float[np.ndarray, " 3"],
    *,
    cell: float,
    device: str = "cpu",
) -> DistanceGrid:
    """`distance_grid` of a mesh over the box from `lower` to `upper` [m], bit by bit, read from the cache if it is there."""
    folder = cache_folder()
    if folder is None:
        return distance_grid(ExactDistance(mesh, device=device), lower, upper, cell=cell)
    file = folder / f"{_key(mesh, lower, upper, cell, device)}.npy"
    values = _read(file)
    if values is None:
        values = distance_grid(ExactDistance(mesh, device=device), lower, upper, cell=cell).values
        _write(file, values)
    return DistanceGrid(values, grid_box(lower, upper, cell=cell)[0], float(cell))


def cache_folder() -> Path | None:
    """Where grids are kept; None where the user wants no cache or has no home."""
    if os.environ.get(SWITCH, "").lower() == OFF:
        return None
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # unset, empty or relative: the XDG specification ignores it
        try:
            base = Path.home() / ".cache"
        except RuntimeError:
            return None
    return base / "dexnudge" / "grids"


def _key(
    mesh: trimesh.Trimesh,
    lower: Float[np.ndarray, " 3"],
    upper: Float[np.ndarray, " 3"],
    cell: float,
    device: str,
) -> str:
    # Warp's version and device: another tree or another processor may round the last bit differently.
    text = f"{wp.config.version} {device.partition(':')[0]} {len(mesh.vertices)} {len(mesh.faces)}"
    key = hashlib.sha256(FORMAT + text.encode())
    for values, kind in ((mesh.vertices, "<f8"), (mesh.faces, "<i8"), ([*lower, *upper, cell], "<f8")):
        key.update(np.ascontiguousarray(values, dtype=kind).tobytes())
    return key.hexdigest()


def _read(file: Path) -> Float[np.ndarray, "x y z"] | None:
    """The values in a file; None where there is no such file or it is not one of ours, whole."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    array, digest = content[:-DIGEST], content[-DIGEST:]
    if _digest(file, array) != digest:
        return None
    with contextlib.suppress(OSError):  # another's folder
        os.utime(file)  # what was used last is deleted last
    values: np.ndarray = np.load(io.BytesIO(array), allow_pickle=False)
    return values


def _write(file: Path, values: Float[np.ndarray, "x y z"]) -> None:
    """Puts a file in its place in one step, so that no other process finds half of it; does without where that fails."""
    content = io.BytesIO()
    np.save(content, values, allow_pickle=False)
    array = content.getvalue()
    with contextlib.suppress(OSError):  # read-only home, full disk: the next run builds the grid again
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


def _digest(file: Path, array: bytes) -> bytes:
    return hashlib.sha256(file.stem.encode() + array).digest()


def _make_room(folder: Path) -> None:
    """Deletes the files that have been unused for longest, until the folder is within its limit."""
    files = []
    for entry in os.scandir(folder):
        found = entry.stat()
        files.append((found.st_mtime_ns, found.st_size, Path(entry.path)))
    total = sum(size for _, size, _ in files)
    for _, size, file in sorted(files):
        if total <= LARGEST_CACHE:
            return
        file.unlink(missing_ok=True)
        total -= size
