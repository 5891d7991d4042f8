"""A surface's points, 2 mm apart, in solids such as a hand's links: its triangles in a tree, their points made there."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.near_faces import faces_near
from dexnudge.geometry.surface_lattice import in_own_planes
from dexnudge.geometry.warp_runtime import WarpStruct, launch_in_threads, wp
from dexnudge.verification.solid_kernel import Surface, surface_in_solids
from dexnudge.verification.solids import Solids

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
