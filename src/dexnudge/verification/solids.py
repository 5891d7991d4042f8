"""Closed bodies that are asked for the exact signed distance, and surfaces whose points are looked for in them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import distinct_rows, faces_near, in_own_planes
from dexnudge.geometry.warp_runtime import WarpStruct, launch_in_threads, wp
from dexnudge.verification.solid_kernel import Solid, Surface, surface_in_solids

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


SURFACE_SPACING = 2e-3
"""Spacing of the object's and the environment's points that are looked for in the hand's links [m]."""
ROOM = 0.25
"""Farther than the hands of a call that faces are kept for those of later ones [m]."""
WIDER = 1e-5
"""By which the bounds of triangles are widened for single precision [m]."""


class TriangleSurface:
    """The surface of a mesh, of which only what hands come near is kept at hand."""

    def __init__(self, mesh: trimesh.Trimesh, *, device: str = "cpu") -> None:
        self._mesh, self.device = mesh, device
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._packed: WarpStruct | None = None
        self._tree: wp.Bvh | None = None

    def raise_depths(
        self,
        solids: Solids,
        T_frame_solid: Float[np.ndarray, "n solid 4 4"],
        deepest: Float[np.ndarray, " n"],
        *,
        clearance: float = 0.0,
    ) -> None:
        """Raise depths [m] already known to the greatest one of the surface's points in solids grown by `clearance` [m].

        solids: with half-spaces.
        """
        low, high = np.moveaxis(solids.bounds, 1, 0)
        rotation = T_frame_solid[..., :3, :3]
        centre = np.einsum("nsij,sj->nsi", rotation, 0.5 * (low + high)) + T_frame_solid[..., :3, 3]
        reach = np.einsum("nsij,sj->nsi", np.abs(rotation), 0.5 * (high - low) + clearance)
        surface = self._around((centre - reach).min(axis=(0, 1)), (centre + reach).max(axis=(0, 1)))
        if surface is None:
            return
        depths = wp.array(deepest, dtype=wp.float64, device=self.device)
        poses = wp.array(T_frame_solid, dtype=wp.mat44d, device=self.device)
        inputs = [surface, poses, *solids.packed, clearance, depths]
        launch_in_threads(surface_in_solids, (len(T_frame_solid), len(solids)), inputs, device=self.device)
        deepest[:] = depths.numpy()

    def _around(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> WarpStruct | None:
        """Return the triangles in a box, and perhaps others; None where there is none."""
        if not ((self._low <= low).all() and (self._high >= high).all()):
            self._low, self._high = np.minimum(self._low, low - ROOM), np.maximum(self._high, high + ROOM)
            faces = np.asarray(self._mesh.faces)[faces_near(self._mesh, np.stack([self._low, self._high]))]
            triangles = np.asarray(np.asarray(self._mesh.vertices)[faces], dtype=np.float64)
            self._packed, self._tree = _packed(triangles, self.device) if len(faces) else (None, None)
        return self._packed


def _packed(triangles: Float[np.ndarray, "face 3 3"], device: str) -> tuple[WarpStruct, wp.Bvh]:
    """Return triangles as the kernel takes them, and the tree of their bounds, which they need as long as they are used."""
    surface, origin = Surface(), triangles.mean(axis=(0, 1))
    low, high = triangles.min(axis=1) - origin - WIDER, triangles.max(axis=1) - origin + WIDER
    tree = wp.Bvh(*(wp.array(side.astype(np.float32), dtype=wp.vec3, device=device) for side in (low, high)))
    surface.bounds, surface.origin = tree.id, wp.vec3d(*origin.tolist())
    surface.corner = wp.array(triangles, dtype=wp.vec3d, device=device)
    surface.flat = wp.array(in_own_planes(triangles), dtype=wp.vec2d, device=device)
    surface.spacing = SURFACE_SPACING
    return surface, tree
