"""How far one can go from points in one direction before a mesh is met."""

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.warp_runtime import wp


@wp.kernel(enable_backward=False)
def _first_hit(
    mesh: wp.uint64, origins: wp.array(dtype=wp.vec3), direction: wp.vec3, reach: float, way: wp.array(dtype=float)
):
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[i], direction, reach)
    way[i] = reach
    if hit.result:
        way[i] = hit.t


class Rays:
    """Rays against one mesh; single precision about the mesh's centre, one core."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.origin = mesh.bounds.mean(axis=0)
        self._mesh = wp.Mesh(
            points=wp.array(np.asarray(mesh.vertices - self.origin, dtype=np.float32), dtype=wp.vec3, device="cpu"),
            indices=wp.array(np.asarray(mesh.faces, dtype=np.int32).ravel(), dtype=wp.int32, device="cpu"),
        )

    def __call__(
        self, points: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "3"], *, reach: float
    ) -> Float[np.ndarray, " n"]:
        """Way [m] from each point along the unit `direction` to the first triangle; `reach` where there is none."""
        way = wp.empty(len(points), dtype=float, device="cpu")
        if len(points):
            origins = wp.array(np.asarray(points - self.origin, dtype=np.float32), dtype=wp.vec3, device="cpu")
            along = wp.vec3(*np.asarray(direction, dtype=float).tolist())
            inputs = [self._mesh.id, origins, along, float(reach)]
            wp.launch(_first_hit, dim=len(points), inputs=inputs, outputs=[way], device="cpu")
        return way.numpy().astype(np.float64)
