"""Signed distances on a grid, by which guidance and projection measure; those of objects are kept on disk."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.ndimage import label

from dexnudge.geometry.disk_cache import cached_array
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.steady_sign import steady_signs
from dexnudge.geometry.warp_runtime import wp

STRIDE = 3  # corners from one exact distance to the next where all are far from the surface
REGION_MARGIN = 0.01  # of a cell, more than half of one, that keeps rounding out
ROUNDING = 1e-3  # the same, of the way to a corner nearby


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
    """Return (origin [m], number of corners along each axis) of the grid over a box, or a little more.

    Corners lie in the box's middle planes: there a slab's distance has its ridge, which cells across it would flatten.
    """
    half_counts = np.maximum(np.ceil((upper - lower) / (2 * cell)).astype(int), 1)
    x, y, z = (2 * half_counts + 1).tolist()
    return np.asarray(0.5 * (lower + upper) - cell * half_counts, dtype=np.float64), (x, y, z)


def distance_grid(
    exact: ExactDistance,
    lower: Float[np.ndarray, " 3"],
    upper: Float[np.ndarray, " 3"],
    *,
    cell: float,
    relevant: float = np.inf,
) -> DistanceGrid:
    """Samples the exact distance over the box of `grid_box` [m] with cells of edge `cell` [m].

    Outside, a value above `relevant` [m] may be less than the distance: what is left of that at a corner nearby.
    """
    origin, counts = grid_box(lower, upper, cell=cell)
    corners = _corners(origin, counts, cell)
    signed = _signed_by_region if exact.closed else _signed_by_steadiness
    values = signed(exact, corners, cell, relevant)
    return DistanceGrid(values.astype(np.float32), origin, float(cell))


def grid_corners(grid: DistanceGrid) -> Float[np.ndarray, "x y z 3"]:
    """Return the places of a grid's values [m]."""
    return _corners(grid.origin, grid.values.shape, grid.cell)


def _corners(origin: Float[np.ndarray, " 3"], counts: Sequence[int], cell: float) -> Float[np.ndarray, "x y z 3"]:
    axes = [origin[axis] + cell * np.arange(counts[axis]) for axis in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij", copy=False), axis=-1)


def _unsigned(
    exact: ExactDistance, corners: Float[np.ndarray, "x y z 3"], cell: float, relevant: float
) -> tuple[Float[np.ndarray, " corner"], Int[np.ndarray, " roughly"]]:
    """Return the unsigned distances [m], and where they are lower bounds above `relevant`, from a corner nearby."""
    places = corners.reshape(-1, 3)
    if relevant == np.inf:
        return exact.distances(places, signed=False), np.zeros(0, dtype=np.int64)
    some = corners[::STRIDE, ::STRIDE, ::STRIDE]
    known = exact.distances(some.reshape(-1, 3), signed=False).reshape(some.shape[:3])
    nearby, ways = _nearby(corners.shape[:3], cell)
    values = known[nearby]
    values -= ways  # distances are 1-Lipschitz
    values = values.reshape(-1)
    asked, roughly = np.flatnonzero(values <= relevant), np.flatnonzero(values > relevant)
    values[asked] = exact.distances(places[asked] if len(roughly) else places, signed=False)
    return values, roughly


def _nearby(
    counts: Sequence[int], cell: float
) -> tuple[tuple[Int[np.ndarray, "..."], ...], Float[np.ndarray, "x y z"]]:
    """Return which of each third corner along each axis is nearest to each corner, and the ways there [m]."""
    places = [np.minimum((np.arange(count) + 1) // STRIDE, (count - 1) // STRIDE) for count in counts]
    ways = [cell * (np.arange(count) - STRIDE * place) for count, place in zip(counts, places, strict=True)]
    x, y, z = np.meshgrid(*(way**2 for way in ways), indexing="ij", sparse=True)
    return np.ix_(*places), np.sqrt(x + y + z)


def _signed_by_region(
    exact: ExactDistance, corners: Float[np.ndarray, "x y z 3"], cell: float, relevant: float
) -> Float[np.ndarray, "x y z"]:
    """Return the signed distance [m] to a closed surface at the corners of a grid, whose sign is asked for at few of them.

    No surface passes between two neighbouring corners that are both farther than half a cell from it, so a whole region
    of such corners has one sign. The sign, by the winding number, takes several times longer than the distance.
    """
    places, counts = corners.reshape(-1, 3), corners.shape[:3]
    values, roughly = _unsigned(exact, corners, cell, relevant)
    far = values > (0.5 + REGION_MARGIN) * cell
    region, count = label(far.reshape(counts))
    region = region.reshape(-1)
    member = np.zeros(count + 1, dtype=np.int64)  # a corner of each region; region 0 is what is near
    member[region] = np.arange(region.size)
    solid = exact.distances(places[member]) < 0.0
    solid[0] = False
    if solid.any():
        _negate(values, exact, places, roughly, inside=solid[region])
    near = np.flatnonzero(~far)
    values[near] = exact.distances(places[near])
    return values.reshape(counts)


def _signed_by_steadiness(
    exact: ExactDistance, corners: Float[np.ndarray, "x y z 3"], cell: float, relevant: float
) -> Float[np.ndarray, "x y z"]:
    """The same of a surface with holes, which has no inside of its own: most signs are those of a corner nearby."""
    places, counts = corners.reshape(-1, 3), corners.shape[:3]
    values, roughly = _unsigned(exact, corners, cell, relevant)
    nearby, ways = _nearby(counts, cell)
    some = corners[::STRIDE, ::STRIDE, ::STRIDE]
    found = steady_signs(exact, some.reshape(-1, 3), within=(1.0 + ROUNDING) * float(ways.max()))
    sign = found.reshape(some.shape[:3])[nearby].reshape(-1)
    inside = (sign < 0) & exact.in_box(places)
    if inside.any():
        _negate(values, exact, places, roughly, inside=inside)
    unsure = np.flatnonzero(sign == 0)
    values[unsure] = exact.distances(places[unsure])
    return values.reshape(counts)


def _negate(
    values: Float[np.ndarray, " corner"],
    exact: ExactDistance,
    places: Float[np.ndarray, "corner 3"],
    roughly: Int[np.ndarray, " roughly"],
    *,
    inside: Bool[np.ndarray, " corner"],
) -> None:
    """Make the distances inside negative, in place, where those known `roughly` are asked for."""
    roughly = roughly[inside[roughly]]
    values[roughly] = exact.distances(places[roughly], signed=False)
    np.negative(values, out=values, where=inside)


FORMAT = "dexnudge distance grid 2"  # another number for other values for the same mesh


def cached_distance_grid(
    mesh: trimesh.Trimesh,
    lower: Float[np.ndarray, " 3"],
    upper: Float[np.ndarray, " 3"],
    *,
    cell: float,
    device: str = "cpu",
) -> DistanceGrid:
    """`distance_grid` of a mesh over the box from `lower` to `upper` [m], bit by bit, read from the cache if it is there."""
    # Warp's version and device: another tree or another processor may round the last bit differently.
    kind = f"{FORMAT} {wp.config.version} {device.partition(':')[0]}"
    values = cached_array(
        kind,
        [np.asarray(mesh.vertices), np.asarray(mesh.faces), np.array([*lower, *upper, cell])],
        lambda: distance_grid(ExactDistance(mesh, device=device), lower, upper, cell=cell).values,
    )
    return DistanceGrid(values, grid_box(lower, upper, cell=cell)[0], float(cell))
