"""How deep two meshes stand in each other, and how far apart they are."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import Boxes, lattice_in_boxes

SPACING = 0.003  # [m] between the points that are tested
MARGIN = 1e-6  # [m] around the bounds, so that rounding drops no point on them


def deepest_overlap(
    first: trimesh.Trimesh, second: trimesh.Trimesh | ExactDistance
) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the largest depth [m] of a point of one mesh inside the other, that point, and the way of `first` out there.

    The depth is 0 where they are apart. The way [m] takes the point to the nearest surface.

    Both ways: evenly spread points of each mesh, its corners and edges among them, against the other's exact distance.
    """
    second = distance_to(second)
    depth, where, way = 0.0, np.asarray(first.vertices[0], dtype=np.float64), np.zeros(3)
    for points_of, inside_of, sign in ((first, second, 1.0), (second.mesh, first, -1.0)):
        inside = distance_to(inside_of)
        points = _points_near(points_of, inside.mesh.bounds)
        if len(points) == 0:
            continue
        hit = inside(points)
        deepest = int(np.argmin(hit.distance))
        if -hit.distance[deepest] > depth:
            depth, where = float(-hit.distance[deepest]), points[deepest]
            way = sign * (hit.closest[deepest] - where)
    return depth, where, way


def way_to_surface(
    body: trimesh.Trimesh, surroundings: trimesh.Trimesh | ExactDistance, *, enough: float = 0.0
) -> Float[np.ndarray, "3"]:
    """Return the shortest vector [m] from a point of `body` to the surface of `surroundings`, or the other way round.

    Between points 3 mm apart and the exact surface: too long by less than 1 mm, and exact between parallel faces. What is
    no longer than `enough` [m] is returned without a search for a shorter one.
    """
    surroundings = distance_to(surroundings)
    shortest = np.full(3, np.inf)
    grown = body.bounds + np.array([[-1.0], [1.0]]) * body.extents.max()
    for mesh, bounds, surface, sign in ((body, body.bounds, surroundings, 1.0), (surroundings.mesh, grown, body, -1.0)):
        points = _points_near(mesh, bounds) if np.linalg.norm(shortest) > enough else np.zeros((0, 3))
        if len(points):
            hit = distance_to(surface).to_surface(points)
            nearest = int(np.argmin(hit.distance))
            way = sign * (hit.closest[nearest] - points[nearest])
            shortest = min(shortest, way, key=lambda vector: float(np.linalg.norm(vector)))
    return shortest


def distance_to(mesh: trimesh.Trimesh | ExactDistance) -> ExactDistance:
    """Return the exact distance to a mesh; built here unless it was before."""
    return mesh if isinstance(mesh, ExactDistance) else ExactDistance(mesh)


def _points_near(mesh: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "n 3"]:
    """Return points of the mesh within the bounds, corners and edges among them."""
    centre, half = bounds.mean(axis=0), np.ptp(bounds, axis=0) / 2 + MARGIN
    box = Boxes(centre=centre[None], axes=np.eye(3)[None], half=half[None])
    return lattice_in_boxes(np.asarray(mesh.triangles), box, spacing=SPACING)[0]
