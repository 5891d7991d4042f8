"""Signed distance on a voxel grid with trilinear value and gradient: fast, for optimisation; never for judging.

Inside the grid the value is trilinear in the eight corners. Outside it is the value at the nearest point of the grid's box
plus the distance to that point, so that what is far away still feels a pull in the right direction.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance

BUILD_THREADS = 2  # Warp's CPU queries hold one thread each and release the interpreter


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
    with ThreadPoolExecutor(BUILD_THREADS) as pool:
        parts = pool.map(lambda points: exact(points).distance, np.array_split(corners, BUILD_THREADS))
    values = np.concatenate(list(parts)).reshape(counts).astype(np.float32)
    return DistanceGrid(values, origin, float(cell))
