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
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Shaped
from scipy.ndimage import label

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.warp_runtime import wp

BUILD_THREADS = 2  # Warp's CPU queries hold one thread each and release the interpreter
REGION_MARGIN = 0.01  # of a cell, more than half of one, that keeps rounding out


@dataclass(frozen=True)
class DistanceGrid:
    """Signed distances [m] at the corners of cubic cells.

    `values[i, j, k]` belongs to `origin` + `cell` * (i, j, k), all in the mesh's frame [m]; negative inside.
    """

    values: Float[np.ndarray, "x y z"]
    origin: Float[np.ndarray, " 3"]
    cell: float


def grid_box(
    lower: Float[np.ndarray, " 3"], upper: Float[np.ndarray, " 3"], *, cell: float
) -> tuple[Float[np.ndarray, " 3"], tuple[int, int, int]]:
    """(origin [m], number of corners along each axis) of the grid over the box from `lower` to `upper`, or a little more.

    Corners lie in the box's middle planes: there a slab's distance has its ridge, which cells across it would flatten.
    """
    half_counts = np.maximum(np.ceil((upper - lower) / (2 * cell)).astype(int), 1)
    x, y, z = (2 * half_counts + 1).tolist()
    return np.asarray(0.5 * (lower + upper) - cell * half_counts, dtype=np.float64), (x, y, z)


def distance_grid(
    exact: ExactDistance, lower: Float[np.ndarray, " 3"], upper: Float[np.ndarray, " 3"], *, cell: float
) -> DistanceGrid:
    """Samples the exact distance over the box of `grid_box` [m] with cells of edge `cell` [m]."""
    origin, counts = grid_box(lower, upper, cell=cell)
    axes = [origin[axis] + cell * np.arange(counts[axis]) for axis in range(3)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if exact.closed:
        values = _signed_by_region(exact, corners.reshape(*counts, 3), cell)
    else:
        values = in_threads(lambda points: exact(points).distance, corners).reshape(counts)
    return DistanceGrid(values.astype(np.float32), origin, float(cell))


def _signed_by_region(
    exact: ExactDistance, corners: Float[np.ndarray, "x y z 3"], cell: float
) -> Float[np.ndarray, "x y z"]:
    """The signed distance [m] at the corners of a grid, whose sign is asked for at few of them.

    No surface passes between two neighbouring corners that are both farther than half a cell from it, so a whole region
    of such corners has one sign. The sign, by the winding number, takes several times longer than the distance.
    """
    values = in_threads(exact.distance_to_surface, corners.reshape(-1, 3))
    values = values.reshape(corners.shape[:3])
    far = values > (0.5 + REGION_MARGIN) * cell
    region, count = label(far)
    member = np.zeros(count + 1, dtype=np.int64)  # a corner of each region; region 0 is what is near
    member[region.ravel()] = np.arange(region.size)
    inside = exact(corners.reshape(-1, 3)[member]).distance < 0.0
    values[inside[region] & far] *= -1.0
    values[~far] = in_threads(lambda points: exact(points).distance, corners[~far])
    return values


def in_threads(
    query: Callable[[Float[np.ndarray, "m 3"]], Shaped[np.ndarray, " m"]], points: Float[np.ndarray, "n 3"]
) -> Shaped[np.ndarray, " n"]:
    """What a query that releases the interpreter finds for each point, on two cores."""
    with ThreadPoolExecutor(BUILD_THREADS) as pool:
        return np.concatenate(list(pool.map(query, np.array_split(points, BUILD_THREADS))))


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
