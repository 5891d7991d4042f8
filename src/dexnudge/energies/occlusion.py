"""Occluded space: where the environment hides the object, and how deep a point lies in it.

Signed distance alone misleads a hand on both sides of a thin wall: each link is pushed out of the wall on its own side. But
a hand reaches an object through free space, and mostly straight. So while a hand is guided, space from which the object
cannot be seen counts as solid, and its depth is the distance to where the object can be seen. Projection counts it in its
first steps only; verification never does.
"""

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.ndimage import affine_transform, distance_transform_edt

from dexnudge.geometry.distance_grid import DistanceGrid, in_threads
from dexnudge.geometry.exact_distance import ExactDistance, warp_mesh
from dexnudge.geometry.surface_points import dart_throwing
from dexnudge.geometry.warp_runtime import wp

OCCLUSION_CELL = 0.018  # [m] edge of the cells whose visibility is tested
SOURCE_LIFT = 0.004  # [m] of the viewpoints above the object's surface
SOURCE_CLEARANCE = 0.003  # [m] that they keep from the environment
SOURCE_GAP = 0.03  # [m] between them


@wp.kernel(enable_backward=False)
def _sees(
    mesh: wp.uint64, cells: wp.array(dtype=wp.vec3), sources: wp.array(dtype=wp.vec3), visible: wp.array(dtype=wp.uint8)
):
    i = wp.tid()
    for k in range(sources.shape[0]):
        way = cells[i] - sources[k]
        length = wp.length(way)
        if not wp.mesh_query_ray_anyhit(mesh, sources[k], way / length, length):
            visible[i] = wp.uint8(1)
            return


def occluded_grid(
    grid: DistanceGrid, object_mesh: trimesh.Trimesh, environment_mesh: trimesh.Trimesh, environment: ExactDistance
) -> DistanceGrid:
    """Return the grid of the environment's distances, lowered to minus the depth in occluded space where that is less.

    Args:
        grid: signed distances [m] to the environment. Where no point of the object sees anything, it is returned as it is.
        object_mesh: in the frame of the grid [m].
        environment_mesh: in the frame of the grid [m].
        environment: exact distance to the environment.
    """
    sources = _sources(object_mesh, environment)
    if len(sources) == 0:
        return grid
    extent = (np.asarray(grid.values.shape) - 1) * grid.cell
    counts = np.maximum(np.ceil(extent / OCCLUSION_CELL).astype(int), 1) + 1
    axes = [grid.origin[axis] + OCCLUSION_CELL * np.arange(counts[axis]) for axis in range(3)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    visible = _visible(environment_mesh, cells, sources).reshape(counts)
    if visible.all() or not visible.any():
        return grid
    # Half a cell is uncertain: an occluded cell next to a visible one is not deep at all.
    depth = np.maximum(distance_transform_edt(~visible) - 1.0, 0.0) * OCCLUSION_CELL
    scale = np.full(3, grid.cell / OCCLUSION_CELL)
    below = -affine_transform(depth, scale, output_shape=grid.values.shape, order=1, mode="nearest")
    lowered = np.where(below < 0.0, np.minimum(grid.values, below), grid.values)
    return DistanceGrid(lowered.astype(np.float32), grid.origin, grid.cell)


def _sources(object_mesh: trimesh.Trimesh, environment: ExactDistance) -> Float[np.ndarray, "k 3"]:
    points, faces = trimesh.sample.sample_surface(object_mesh, 400, seed=np.random.default_rng(0))
    lifted = points + SOURCE_LIFT * object_mesh.face_normals[faces]
    lifted = lifted[environment(lifted).distance > SOURCE_CLEARANCE]
    return lifted[dart_throwing(lifted, SOURCE_GAP)] if len(lifted) else lifted


def _visible(
    environment_mesh: trimesh.Trimesh, cells: Float[np.ndarray, "n 3"], sources: Float[np.ndarray, "k 3"]
) -> Bool[np.ndarray, " n"]:
    mesh = warp_mesh(environment_mesh.vertices, environment_mesh.faces)
    viewpoints = wp.array(sources.astype(np.float32), dtype=wp.vec3, device="cpu")

    def seen(part: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
        visible = wp.zeros(len(part), dtype=wp.uint8, device="cpu")
        inputs = [mesh.id, wp.array(part.astype(np.float32), dtype=wp.vec3, device="cpu"), viewpoints, visible]
        wp.launch(_sees, dim=len(part), inputs=inputs, device="cpu")
        return visible.numpy().astype(bool)

    wp.load_module(_sees.module, device="cpu")
    return in_threads(seen, cells)
