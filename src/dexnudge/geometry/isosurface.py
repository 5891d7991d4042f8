"""The surface on which a grid of values changes sign."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from dexnudge.geometry.warp_runtime import wp

LEAST = 1e-3  # of a value: a vertex stays this far from the ends of its edge, so that no triangle shrinks to a point


def isosurface(
    values: Float[np.ndarray, "x y z"],
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"], Int[np.ndarray, "vertex 2 3"]]:
    """Return vertices in units of the grid, faces, and the two nodes between which each vertex lies.

    Marching cubes (Lorensen and Cline, SIGGRAPH 1987) by Warp, on the cells that the surface passes only. Normals point
    toward positive values. The surface is closed where it does not leave the grid. The first node of a pair has the lower
    index.
    """
    from warp.geometry import IsoSurfaceMarchingCubes, sparse_marching_cubes_from_cells  # after Warp was made quiet

    inside = values < 0
    every, some = inside, inside
    for axis in range(3):
        lower, upper = [slice(None)] * 3, [slice(None)] * 3
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        every = every[tuple(lower)] & every[tuple(upper)]
        some = some[tuple(lower)] | some[tuple(upper)]
    cells = np.argwhere(some & ~every).astype(np.int32)
    if not len(cells):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), np.zeros((0, 2, 3), dtype=np.int64)
    corners = cells[:, None] + np.asarray(IsoSurfaceMarchingCubes.CUBE_CORNER_OFFSETS, dtype=np.int32)
    at_corners = values[corners[..., 0], corners[..., 1], corners[..., 2]].astype(np.float32)
    at_corners = np.where(np.abs(at_corners) < LEAST, np.where(at_corners < 0, -LEAST, LEAST), at_corners)
    given = wp.array(at_corners, dtype=wp.float32, device="cpu")
    found, triangles = sparse_marching_cubes_from_cells(cells, given, device="cpu")
    vertices = found.numpy().astype(np.float64)
    nearest = np.rint(vertices).astype(np.int64)
    along, all_of_them = np.abs(vertices - nearest).argmax(axis=1), np.arange(len(vertices))
    nodes = np.stack([nearest, nearest], axis=1)
    nodes[all_of_them, 0, along] = np.floor(vertices[all_of_them, along])
    nodes[all_of_them, 1, along] = nodes[all_of_them, 0, along] + 1
    return vertices, triangles.numpy().reshape(-1, 3), nodes
