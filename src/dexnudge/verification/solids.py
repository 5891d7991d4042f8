"""Closed bodies that are asked for the exact signed distance: an object, its surroundings, the links of a hand."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import distinct_rows
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.verification.solid_kernel import Solid

DIRECTIONS = np.asarray(trimesh.creation.icosphere(subdivisions=1).vertices)
"""Normals of the half-spaces that rule out most points before any distance is asked for."""


class SolidDistance:
    """Exact signed distance to a mesh, with its bounding box and the size of its holes.

    Where the surface is closed, signed distance is 1-Lipschitz: a ball about a point farther outside than its radius
    holds no inner point. Through a hole of diameter h the sign may change without the surface being met; then the
    ball must be h farther away. A mesh whose triangles disagree about the outside has no such bound (infinity).
    `widest_hole` [m] bounds h: through a wider opening, such as the border of a scan, the sign changes in free air, far
    from any surface, where it means nothing.
    """

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        query: ExactDistance | None = None,
        *,
        widest_hole: float = np.inf,
        device: str = "cpu",
    ) -> None:
        self.query = query or ExactDistance(mesh, device=device)
        self.low, self.high = np.asarray(mesh.bounds, dtype=np.float64)
        self.hole = min(hole_diameter(mesh), widest_hole)

    @cached_property
    def packed(self) -> WarpStruct:
        """The solid as the kernels take it."""
        solid = Solid()
        solid.mesh, solid.low, solid.high = self.query.packed()
        solid.origin, solid.hole = wp.vec3d(*self.query.origin.tolist()), self.hole
        solid.closed = self.hole == 0.0 and self.query.closed
        return solid


class Solids:
    """Several solids in an array for the kernels.

    Args:
        solids: those.
        half_spaces: whether to know the half-spaces that hold each: worth while where many points are asked for.
        device: of Warp.
    """

    def __init__(self, solids: Sequence[SolidDistance], *, half_spaces: bool = False, device: str = "cpu") -> None:
        self.each, self.device = tuple(solids), device
        extents = np.zeros((len(self.each), 0))
        if half_spaces:
            # No point is deeper in a solid than in the least of its half-spaces.
            extents = np.stack([(solid.query.mesh.vertices @ DIRECTIONS.T).max(axis=0) for solid in self.each])
        self.packed: tuple[Any, Any, Any] = (
            wp.array([solid.packed for solid in self.each], dtype=Solid, device=device),
            wp.array(extents, dtype=wp.float64, device=device),
            wp.array(DIRECTIONS, dtype=wp.vec3d, device=device),
        )

    def __len__(self) -> int:
        return len(self.each)

    @property
    def bounds(self) -> Float[np.ndarray, "solid 2 3"]:
        """Lower and upper corners of their boxes [m], each in its own frame."""
        return np.stack([[solid.low, solid.high] for solid in self.each])


def hole_diameter(mesh: trimesh.Trimesh) -> float:
    """Largest diagonal of the bounding box of a connected set of open edges [m]; infinite where orientations clash."""
    if not mesh.is_winding_consistent:
        return np.inf
    if mesh.is_watertight:
        return 0.0
    edges = np.asarray(mesh.edges_sorted)
    first, edge = distinct_rows(edges)
    open_edges = edges[first][np.bincount(edge) % 2 == 1]
    groups = trimesh.graph.connected_components(open_edges)
    return max((float(np.linalg.norm(np.ptp(mesh.vertices[group], axis=0))) for group in groups), default=0.0)
