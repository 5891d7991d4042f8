"""Exact signed distance to a triangle mesh: closest point in a bounding-volume tree, sign by the winding number.

The generalised winding number (Jacobson et al., SIGGRAPH 2013) gives the right sign on meshes with holes, with
inner parts and with overlapping pieces, where a sign from face normals does not. NEGATIVE INSIDE. `Rays` asks the same tree
how far one can go.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int, Num

from dexnudge.geometry.warp_runtime import launch_in_threads, wp


@wp.kernel(enable_backward=False)
def _first_hit(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    reach: float,
    way: wp.array(dtype=float),
    face: wp.array(dtype=int),
):
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[i], directions[i % directions.shape[0]], reach)
    way[i] = reach
    face[i] = -1
    if hit.result:
        way[i] = hit.t
        face[i] = hit.face


def warp_mesh(
    vertices: Num[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], *, device: str = "cpu", winding: bool = False
) -> wp.Mesh:
    """Return a mesh's tree in single precision; with `winding` it tells inside from outside, too."""
    points = wp.array(np.asarray(vertices, dtype=np.float32), dtype=wp.vec3, device=device)
    corners = wp.array(np.asarray(faces, dtype=np.int32).ravel(), dtype=wp.int32, device=device)
    return wp.Mesh(points=points, indices=corners, support_winding_number=winding)


class Rays:
    """Rays against one mesh; single precision about the mesh's centre, one core."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.origin = mesh.bounds.mean(axis=0)
        self._mesh = warp_mesh(mesh.vertices - self.origin, mesh.faces)

    def __call__(
        self, points: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "3"], *, reach: float
    ) -> Float[np.ndarray, " n"]:
        """Way [m] from each point along the unit `direction` to the first triangle; `reach` where there is none."""
        return self.first_hits(points, direction[None], reach=reach)[0]

    def first_hits(
        self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "m 3"], *, reach: float
    ) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Way [m] from each point along its own unit direction, or one for all, and the triangle; `reach`, -1 for none."""
        way, face = wp.empty(len(points), dtype=float, device="cpu"), wp.empty(len(points), dtype=int, device="cpu")
        if len(points):
            origins, along = (
                wp.array(np.ascontiguousarray(each, dtype=np.float32), dtype=wp.vec3, device="cpu", copy=False)
                for each in (points - self.origin, directions)
            )
            inputs = [self._mesh.id, origins, along, float(reach)]
            wp.launch(_first_hit, dim=len(points), inputs=inputs, outputs=[way, face], device="cpu")
        return way.numpy().astype(np.float64), face.numpy()


INSIDE_WINDING_NUMBER = wp.constant(0.5)  # a point is inside where the surface winds around it at least half a turn
WINDING_ACCURACY = wp.constant(2.0)  # Barnes-Hut opening ratio of Warp's fast winding number; 2 is Warp's default
SEARCH_RADIUS = wp.constant(1.0e3)  # [m] farther than any scene is wide
CLEAR_OF_SURFACE = wp.constant(1.0e-6)  # [m] from where on the way away from the closest point is known


@dataclass(frozen=True)
class ExactHit:
    """What the query found for each point.

    `distance` [m], negative inside; `closest` [m], on the mesh; `normal`, unit, outward, of the nearest triangle;
    `face`, the index of that triangle.
    """

    distance: Float[np.ndarray, " n"]
    closest: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    face: Int[np.ndarray, " n"]


@wp.func
def surface_nearest(mesh: wp.uint64, p: wp.vec3, reach: float):
    """Return (distance, closest point, face) of a mesh within `reach` of p; infinite where there is none."""
    hit = wp.mesh_query_point_no_sign(mesh, p, reach)
    distance = float(wp.inf)
    closest = p
    face = 0
    if hit.result:
        face = hit.face
        closest = wp.mesh_eval_position(mesh, face, hit.u, hit.v)
        distance = wp.length(p - closest)
    return distance, closest, face


@wp.func
def signed_nearest(mesh: wp.uint64, p: wp.vec3, low: wp.vec3, high: wp.vec3):
    """Return (signed distance, closest point, face) of a mesh with these bounds."""
    # Outside the bounding box the winding number of any simple surface, even one with holes, is at most a half.
    outside = p[0] < low[0] or p[1] < low[1] or p[2] < low[2] or p[0] > high[0] or p[1] > high[1] or p[2] > high[2]
    if outside:
        hit = wp.mesh_query_point_no_sign(mesh, p, SEARCH_RADIUS)
        sign = float(1.0)  # noqa: UP018 - declares a variable of Warp
    else:
        hit = wp.mesh_query_point_sign_winding_number(mesh, p, SEARCH_RADIUS, WINDING_ACCURACY, INSIDE_WINDING_NUMBER)
        sign = float(hit.sign)
    closest = wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v)
    return sign * wp.length(p - closest), closest, hit.face


@wp.func
def closed_nearest(mesh: wp.uint64, p: wp.vec3, low: wp.vec3, high: wp.vec3):
    """Return what `signed_nearest` does, of a closed surface and mostly sooner: a ray that meets nothing begins outside."""
    distance, closest, face = surface_nearest(mesh, p, SEARCH_RADIUS)
    if distance > CLEAR_OF_SURFACE:  # noqa: SIM102 - Warp evaluates both sides of an `and`
        if not wp.mesh_query_ray_anyhit(mesh, p, (p - closest) / distance, SEARCH_RADIUS):
            return distance, closest, face
    distance, closest, face = signed_nearest(mesh, p, low, high)
    return distance, closest, face


@wp.kernel(enable_backward=False)
def _query(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    low: wp.vec3,
    high: wp.vec3,
    distance: wp.array(dtype=float),
    closest: wp.array(dtype=wp.vec3),
    face: wp.array(dtype=int),
):
    i = wp.tid()
    d, c, f = signed_nearest(mesh, points[i], low, high)
    distance[i] = d
    closest[i] = c
    face[i] = f


@wp.kernel(enable_backward=False)
def _query_surface(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    reach: float,
    distance: wp.array(dtype=float),
    closest: wp.array(dtype=wp.vec3),
    face: wp.array(dtype=int),
):
    i = wp.tid()
    d, c, f = surface_nearest(mesh, points[i], reach)
    distance[i] = d
    closest[i] = c
    face[i] = f


UNSIGNED, SIGNED, CLOSED = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.kernel(enable_backward=False)
def _distances(
    first: int,
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    low: wp.vec3,
    high: wp.vec3,
    kind: int,
    distance: wp.array(dtype=float),
):
    i = first + wp.tid()
    if kind == UNSIGNED:
        d, _c, _f = surface_nearest(mesh, points[i], SEARCH_RADIUS)
    elif kind == SIGNED:
        d, _c, _f = signed_nearest(mesh, points[i], low, high)
    else:
        d, _c, _f = closed_nearest(mesh, points[i], low, high)
    distance[i] = d


def open_edges(mesh: trimesh.Trimesh) -> tuple[Float[np.ndarray, "edge 2 3"], Int[np.ndarray, " edge"]]:
    """Return the edges [m] along which a surface ends, and how often: triangles run along them more in one direction."""
    pairs = np.asarray(mesh.faces, dtype=np.int64)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward = pairs[:, 0] < pairs[:, 1]
    _, first, edge = np.unique(
        pairs.min(axis=1) * len(mesh.vertices) + pairs.max(axis=1), return_index=True, return_inverse=True
    )
    times = np.abs(np.bincount(edge, np.where(forward, 1, -1))).astype(np.int64)
    return np.asarray(mesh.vertices)[pairs[first[times > 0]]], times[times > 0]


class ExactDistance:
    """Signed distance of points to one mesh [m], exact to single precision, negative inside.

    Args:
        mesh: triangles in the frame in which the points will be given. Must have at least one face. Kept, as `mesh`.
    """

    def __init__(self, mesh: trimesh.Trimesh, *, device: str = "cpu") -> None:
        self.device = device
        # The mesh is queried about its own centre: single precision is finest there.
        self.origin = mesh.bounds.mean(axis=0)
        vertices = np.asarray(mesh.vertices - self.origin, dtype=np.float32)
        self._mesh = warp_mesh(vertices, mesh.faces, device=device, winding=True)
        self._low, self._high = (wp.vec3(*corner.tolist()) for corner in (vertices.min(axis=0), vertices.max(axis=0)))
        self.face_normals = np.asarray(mesh.face_normals)
        self.mesh = mesh

    @property
    def closed(self) -> bool:
        """Whether the surface has neither holes nor triangles that disagree about the outside.

        Then the sign can change only where the distance is 0.
        """
        return bool(self.mesh.is_watertight and self.mesh.is_winding_consistent)

    @cached_property
    def open_edges(self) -> tuple[Float[np.ndarray, "edge 2 3"], Int[np.ndarray, " edge"]]:
        """What `open_edges` finds of the mesh."""
        return open_edges(self.mesh)

    def in_box(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which points [m] are not beyond the mesh's bounding box, where every place is outside."""
        local = (points - self.origin).astype(np.float32)
        low, high = np.asarray(self._low), np.asarray(self._high)
        return ((local >= low) & (local <= high)).all(axis=1)

    def packed(self) -> tuple[Any, Any, Any]:
        """Return what `signed_nearest` takes: the mesh about `origin`, and its bounds."""
        return self._mesh.id, self._low, self._high

    def to_surface(self, points: Float[np.ndarray, "n 3"], *, reach: float = SEARCH_RADIUS) -> ExactHit:
        """Return what lies nearest to each point [m, the mesh's frame], without the sign, which takes longer than the rest.

        Equal to what a call finds, but that no distance is negative; and where nothing lies within `reach` [m] it is
        infinite, and the rest of the hit means nothing.
        """
        return self._launch(_query_surface, points, [reach])

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> ExactHit:
        """Return what lies nearest to each point [m, the mesh's frame]."""
        return self._launch(_query, points, [self._low, self._high])

    def distances(self, points: Float[np.ndarray, "n 3"], *, signed: bool = True) -> Float[np.ndarray, " n"]:
        """Return nothing but the distances [m], asked for by `THREADS`: of many points, such as those of a grid."""
        local = np.empty((len(points), 3), dtype=np.float32)
        np.subtract(points, self.origin, out=local, casting="same_kind")  # rounded once, as it is written
        found = wp.empty(len(points), dtype=float, device=self.device)
        kind = UNSIGNED if not signed else CLOSED if self.closed else SIGNED
        local = wp.array(local, dtype=wp.vec3, device=self.device, copy=False)
        inputs = [self._mesh.id, local, self._low, self._high, kind, found]
        launch_in_threads(_distances, [len(points)], inputs, device=self.device)
        return found.numpy().astype(np.float64)

    def _launch(self, kernel: Any, points: Float[np.ndarray, "n 3"], inputs: list[Any]) -> ExactHit:
        """Run a kernel about the mesh's centre and return what it found, in the mesh's frame."""
        count = len(points)
        if count == 0:
            return ExactHit(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.int32))
        local = np.ascontiguousarray(points - self.origin, dtype=np.float32)
        local = wp.array(local, dtype=wp.vec3, device=self.device, copy=False)
        distance = wp.empty(count, dtype=float, device=self.device)
        closest = wp.zeros(count, dtype=wp.vec3, device=self.device)
        face = wp.zeros(count, dtype=int, device=self.device)
        outputs = [distance, closest, face]
        wp.launch(kernel, dim=count, inputs=[self._mesh.id, local, *inputs], outputs=outputs, device=self.device)
        faces = face.numpy()
        return ExactHit(
            distance.numpy().astype(np.float64),
            closest.numpy().astype(np.float64) + self.origin,
            self.face_normals[faces],
            faces,
        )
