"""How deep two bodies are in one another."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import surface_points

SPACING = 0.003  # [m] between the points that are tested; vertices are tested as well


def deepest_overlap(first: trimesh.Trimesh, second: trimesh.Trimesh) -> tuple[float, Float[np.ndarray, "3"]]:
    """Largest depth [m] of a point of one mesh inside the other, and that point; 0 and a point where they are apart.

    Both ways: vertices and evenly spread surface points of each mesh against the other's exact distance.
    """
    depth, where = 0.0, np.asarray(first.vertices[0], dtype=np.float64)
    for points_of, inside_of in ((first, second), (second, first)):
        points = _points_near(points_of, inside_of.bounds)
        if len(points) == 0:
            continue
        distance = ExactDistance(inside_of)(points).distance
        deepest = int(np.argmin(distance))
        if -distance[deepest] > depth:
            depth, where = float(-distance[deepest]), points[deepest]
    return depth, where


def _points_near(mesh: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "n 3"]:
    """Vertices and surface points of the part of the mesh within the bounds."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    origins = np.concatenate([np.repeat(bounds[:1], 3, axis=0), np.repeat(bounds[1:], 3, axis=0)])
    # Cut before sampling: most of a table is far from the object.
    part = trimesh.intersections.slice_mesh_plane(mesh, normals, origins, cap=False)
    if len(part.faces) == 0:
        return np.zeros((0, 3))
    points = surface_points(part, spacing=SPACING).points
    return np.asarray(np.concatenate([part.vertices, points]), dtype=np.float64)
