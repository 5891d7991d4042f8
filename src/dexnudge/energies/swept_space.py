"""How close the environment comes to a point of the hand while the hand is carried along the motion.

A push moves the whole hand rigidly with the object, so a point p of it meets

    swept(p) = min over 0 <= s <= L of phi_env(p + s m),   m the motion's unit vector, L its length [m],

phi_env the signed distance [m], negative inside. On a grid with an axis along m that is a running minimum over its cells. A
surface along which the hand slides changes nothing: its distance is the same all along.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates, minimum_filter1d

from dexnudge.geometry.distance_grid import DistanceGrid


def swept_grid(
    grid: DistanceGrid, displacement: Float[np.ndarray, " 3"], *, around: DistanceGrid | None = None
) -> DistanceGrid:
    """The least distance [m] that each corner of a grid meets on its way; exact up to half a cell at the way's end.

    Args:
        grid: signed distances [m] to the environment.
        displacement: m times L [m], in the frame of the grid, along one of its axes; what it has across the axis of its
            largest component is neglected. Where it is shorter than half a cell, `grid` itself is returned.
        around: a larger grid of the same distances, looked up where the way leaves `grid`; without it that part of the way
            does not count.
    """
    axis = int(np.abs(displacement).argmax())
    sign = 1 if displacement[axis] > 0 else -1
    steps = round(abs(float(displacement[axis])) / grid.cell)
    if steps == 0:
        return grid
    count = grid.values.shape[axis]
    way = grid.values
    if around is not None:
        way = np.concatenate([grid.values, _ahead(grid, around, axis, sign, steps)][::sign], axis=axis)
    forward = np.flip(way, axis) if sign < 0 else way
    # Shifted so that the window of each corner begins at the corner itself.
    least = minimum_filter1d(forward, steps + 1, axis=axis, origin=-((steps + 1) // 2), mode="nearest")
    least = np.take(least, np.arange(count), axis=axis)
    return DistanceGrid(np.flip(least, axis) if sign < 0 else least, grid.origin, grid.cell)


def _ahead(grid: DistanceGrid, around: DistanceGrid, axis: int, sign: int, steps: int) -> Float[np.ndarray, "x y z"]:
    """Distances of the larger grid at the corners by which `grid` would be continued in the direction of the way."""
    counts = list(grid.values.shape)
    counts[axis] = steps
    origin = np.array(grid.origin, dtype=np.float64)
    origin[axis] += grid.cell * (grid.values.shape[axis] if sign > 0 else -steps)
    corners = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"))
    places = (origin[:, None, None, None] + grid.cell * corners - around.origin[:, None, None, None]) / around.cell
    return map_coordinates(around.values, places, order=1, mode="nearest").astype(grid.values.dtype)
