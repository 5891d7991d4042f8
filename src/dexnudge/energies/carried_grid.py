"""The least distance to the surroundings that a point meets while it is carried along a motion that turns."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from dexnudge.energies.grid_kernel import PackedGrids, grid_distance, inside_box, pack_grids
from dexnudge.geometry.distance_grid import DistanceGrid, grid_corners
from dexnudge.geometry.exact_distance import SEARCH_RADIUS
from dexnudge.geometry.warp_runtime import launch_in_threads, wp
from dexnudge.scenes.motion import Motion


def carried_grid(
    grid: DistanceGrid, motion: Motion, *, around: DistanceGrid | None = None, relevant: float = np.inf
) -> DistanceGrid:
    """Return the least distance [m] that each corner of a grid meets while it is carried along a motion.

    It is looked up at poses between which no corner moves farther than a cell.

    Args:
        grid: signed distances [m] to the environment.
        motion: in the frame of the grid.
        around: a larger grid of the same distances, looked up where a corner is carried out of `grid`.
        relevant: above this [m] a value may be more than the least distance; that is then above it, too, up to two cells.
    """
    corners = grid_corners(grid)
    poses = np.stack([motion.displacement(way) for way in _ways(motion, corners, grid.cell)])
    packed = pack_grids([grid, around or grid])
    frames = wp.array(poses.astype(np.float32), dtype=wp.mat44, device="cpu")
    points = np.ascontiguousarray(corners.reshape(-1, 3), dtype=np.float32)
    found = wp.zeros(len(points), dtype=float, device="cpu")
    given = wp.array(points, dtype=wp.vec3, device="cpu", copy=False)
    inputs = [packed, frames, grid.cell, min(relevant, SEARCH_RADIUS), given, found]
    launch_in_threads(least_distances, [len(points)], inputs, device="cpu")
    values = found.numpy().reshape(grid.values.shape)
    return DistanceGrid(np.minimum(values, grid.values), grid.origin, grid.cell)  # rounded nowhere above


def _ways(motion: Motion, corners: Float[np.ndarray, "x y z 3"], cell: float) -> Float[np.ndarray, " pose"]:
    """Return ways [m] along a motion between which no corner moves farther than a cell."""
    box = corners[:: len(corners) - 1, :: corners.shape[1] - 1, :: corners.shape[2] - 1].reshape(-1, 3)
    ways = [np.zeros(1)]
    for start, end in pairwise([*motion.beginnings, motion.length]):
        fastest = np.linalg.norm(motion.twist(start).velocity(box), axis=1).max() if start < motion.turn_length else 1.0
        ways.append(np.linspace(start, end, 1 + int(np.ceil((end - start) * fastest / cell)))[1:])
    return np.concatenate(ways)


@wp.kernel(enable_backward=False)
def least_distances(
    first: int,
    grids: PackedGrids,
    poses: wp.array(dtype=wp.mat44),
    step: float,
    relevant: float,
    points: wp.array(dtype=wp.vec3),
    least: wp.array(dtype=float),
):
    """One point: the least distance [m] over all poses, which move it by at most `step` [m] from one to the next."""
    i = first + wp.tid()
    found = grid_distance(grids.headers[0], grids.values, points[i])[0]
    pose = wp.int32(1)
    while pose < poses.shape[0]:
        p = wp.transform_point(poses[pose], points[i])
        looked_up = grids.headers[1]
        if inside_box(grids.headers[0], p):
            looked_up = grids.headers[0]
        distance = grid_distance(looked_up, grids.values, p)[0]
        found = wp.min(found, distance)
        # No nearer can be reached sooner: distances are 1-Lipschitz, looked up to within a cell.
        pose += wp.max(1, int((distance - wp.min(found, relevant)) / step) - 1)
    least[i] = found
