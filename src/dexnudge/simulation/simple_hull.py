"""Convex bodies with few vertices: contacts between small ones are fast."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull


def simple_hull(points: Float[np.ndarray, "point 3"], *, tolerance: float) -> Float[np.ndarray, "vertex 3"]:
    """Some of the points, whose hull leaves out at most `tolerance` [m] of the hull of all.

    Points are added one by one where they lie farthest outside the hull of those before (quickhull's rule, Barber et
    al., 1996, stopped early).
    """
    vertices = points[ConvexHull(points).vertices]
    chosen = _first_body(vertices)
    while True:
        equations = ConvexHull(vertices[chosen]).equations
        outside = (vertices @ equations[:, :3].T + equations[:, 3]).max(axis=1)
        if outside.max() <= tolerance:
            return vertices[chosen]
        chosen.append(int(outside.argmax()))


def _first_body(vertices: Float[np.ndarray, "vertex 3"]) -> list[int]:
    """Indices of four vertices that span a volume: each is farthest from the point, line or plane of those before."""
    chosen = [int(vertices[:, 0].argmin())]
    offset = vertices - vertices[chosen[0]]
    for _ in range(3):
        chosen.append(int(np.linalg.norm(offset, axis=1).argmax()))
        direction = offset[chosen[-1]] / np.linalg.norm(offset[chosen[-1]])
        offset = offset - np.outer(offset @ direction, direction)
    return chosen
