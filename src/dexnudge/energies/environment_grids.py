"""Distances to the environment as guidance sees them: deeper where it hides the object, least along a motion that turns.

Signed distance alone misleads a hand on both sides of a thin wall: each link is pushed out of the wall on its own side. But
a hand reaches an object through free space, and mostly straight. So while a hand is guided, space from which the object
cannot be seen counts as solid, and its depth is the distance to where the object can be seen. Projection counts it in its
first steps only; verification never does.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from dexnudge.energies.grid_kernel import PackedGrids, grid_distance, inside_box, pack_grids
from dexnudge.geometry.distance_grid import DistanceGrid, grid_corners
from dexnudge.geometry.exact_distance import SEARCH_RADIUS, ExactDistance, warp_mesh
from dexnudge.geometry.surface_points import dart_throwing
from dexnudge.geometry.warp_runtime import launch_in_threads, wp
from dexnudge.scenes.motion import Motion

OCCLUSION_CELL = 0.018  # [m] edge of the cells whose visibility is tested
SOURCE_LIFT = 0.004  # [m] of the viewpoints above the object's surface
SOURCE_CLEARANCE = 0.003  # [m] that they keep from the environment
SOURCE_GAP = 0.03  # [m] between them
WELL_INSIDE = wp.constant(1.0e-3)  # of a triangle's sides and of the way, farther from an edge than rounding
STEEPEST = wp.constant(1.0e-2)  # sine of the least angle between way and triangle


@wp.func
def _blocks(mesh: wp.uint64, face: int, start: wp.vec3, way: wp.vec3):
    """Whether one triangle surely stands in the way: a query of the tree would meet it, too."""
    corner = wp.mesh_get_point(mesh, 3 * face)
    side, other = wp.mesh_get_point(mesh, 3 * face + 1) - corner, wp.mesh_get_point(mesh, 3 * face + 2) - corner
    normal = wp.cross(side, other)
    across = wp.dot(way, normal)
    if wp.abs(across) <= STEEPEST * wp.length(way) * wp.length(normal):
        return False
    offset = start - corner
    turned = wp.cross(offset, way)
    u, v = -wp.dot(other, turned) / across, wp.dot(side, turned) / across
    t = -wp.dot(normal, offset) / across
    inside = wp.min(wp.min(u, v), 1.0 - u - v) > WELL_INSIDE
    return inside and t > WELL_INSIDE and t < 1.0 - WELL_INSIDE


@wp.kernel(enable_backward=False)
def _sees(
    first: int,
    mesh: wp.uint64,
    sources: wp.array(dtype=wp.vec3),
    cells: wp.array2d(dtype=wp.vec3),
    visible: wp.array2d(dtype=wp.uint8),
):
    """One row of cells: what hides one of them from a viewpoint mostly hides the next, and is asked first."""
    row = first + wp.tid()
    for k in range(sources.shape[0]):
        blocking = wp.int32(-1)
        for i in range(cells.shape[1]):
            if visible[row, i] == wp.uint8(0):
                way = cells[row, i] - sources[k]
                hidden = False
                if blocking >= 0:
                    hidden = _blocks(mesh, blocking, sources[k], way)
                if not hidden:
                    length = wp.length(way)
                    hit = wp.mesh_query_ray(mesh, sources[k], way / length, length)
                    if hit.result:
                        blocking = hit.face
                    else:
                        visible[row, i] = wp.uint8(1)


def occluded_grids(
    grids: Sequence[DistanceGrid],
    object_mesh: trimesh.Trimesh,
    environment_mesh: trimesh.Trimesh,
    environment: ExactDistance,
) -> list[DistanceGrid]:
    """Return grids of the environment's distances, lowered to minus the depth in occluded space where that is less.

    Args:
        grids: signed distances [m] to the environment. Where no point of the object sees anything, one is returned as it is.
        object_mesh: in the frame of the grids [m].
        environment_mesh: in the frame of the grids [m].
        environment: exact distance to the environment.
    """
    sources = _sources(object_mesh, environment)
    if len(sources) == 0:
        return list(grids)
    mesh = warp_mesh(environment_mesh.vertices, environment_mesh.faces)
    viewpoints = wp.array(sources.astype(np.float32), dtype=wp.vec3, device="cpu")
    return [_occluded(grid, mesh, viewpoints) for grid in grids]


def _occluded(grid: DistanceGrid, environment: wp.Mesh, viewpoints: wp.array) -> DistanceGrid:
    extent = (np.asarray(grid.values.shape) - 1) * grid.cell
    x, y, z = (np.maximum(np.ceil(extent / OCCLUSION_CELL).astype(int), 1) + 1).tolist()
    axes = [grid.origin[axis] + OCCLUSION_CELL * np.arange(count) for axis, count in enumerate((x, y, z))]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(x * y, z, 3).astype(np.float32)
    seen = wp.zeros((x * y, z), dtype=wp.uint8, device="cpu")
    inputs = [environment.id, viewpoints, wp.array(cells, dtype=wp.vec3, device="cpu", copy=False), seen]
    launch_in_threads(_sees, [x * y], inputs, device="cpu")
    visible = seen.numpy().astype(bool).reshape(x, y, z)
    if visible.all() or not visible.any():
        return grid
    # Half a cell is uncertain: an occluded cell next to a visible one is not deep at all.
    depth = np.maximum(distance_transform_edt(~visible) - 1.0, 0.0) * OCCLUSION_CELL
    depth = _interpolated(depth, grid.values.shape, grid.cell / OCCLUSION_CELL)
    lowered = np.where(depth > 0.0, np.minimum(grid.values, -depth), grid.values)
    return DistanceGrid(lowered.astype(np.float32), grid.origin, grid.cell)


def _interpolated(values: Float[np.ndarray, "i j k"], counts: Sequence[int], step: float) -> Float[np.ndarray, "x y z"]:
    """Return values at places that lie `step` of a cell apart along each axis, from those at the cells."""
    for axis, count in enumerate(counts):
        place = np.minimum(step * np.arange(count), values.shape[axis] - 1)
        below = np.minimum(place.astype(int), values.shape[axis] - 2)
        share = np.expand_dims(place - below, [other for other in range(3) if other != axis])
        values, above = values.take(below, axis), values.take(below + 1, axis)
        values *= 1 - share
        above *= share
        values += above
    return values


def _sources(object_mesh: trimesh.Trimesh, environment: ExactDistance) -> Float[np.ndarray, "k 3"]:
    points, faces = trimesh.sample.sample_surface(object_mesh, 400, seed=np.random.default_rng(0))
    lifted = points + SOURCE_LIFT * object_mesh.face_normals[faces]
    lifted = lifted[environment(lifted).distance > SOURCE_CLEARANCE]
    return lifted[dart_throwing(lifted, SOURCE_GAP)] if len(lifted) else lifted


def carried_grid(
    grid: DistanceGrid, motion: Motion, *, around: DistanceGrid | None = None, relevant: float = np.inf
) -> DistanceGrid:
    """Return the least distance [m] that each corner of a grid meets while it is carried along a motion.

    It is looked up at poses between which no corner moves farther than a cell.

    Args:
        grid: signed distances [m] to the environment.
        motion: in the frame of the grid.
        around: a larger grid of the same distances, looked up where a corner is carried out of `grid`.
        relevant: above this [m] a value may be more than the least distance; that is then above it, too, up to two cells.
    """
    corners = grid_corners(grid)
    poses = np.stack([motion.displacement(way) for way in _ways(motion, corners, grid.cell)])
    packed = pack_grids([grid, around or grid])
    frames = wp.array(poses.astype(np.float32), dtype=wp.mat44, device="cpu")
    points = np.ascontiguousarray(corners.reshape(-1, 3), dtype=np.float32)
    found = wp.zeros(len(points), dtype=float, device="cpu")
    given = wp.array(points, dtype=wp.vec3, device="cpu", copy=False)
    inputs = [packed, frames, grid.cell, min(relevant, SEARCH_RADIUS), given, found]
    launch_in_threads(least_distances, [len(points)], inputs, device="cpu")
    values = found.numpy().reshape(grid.values.shape)
    return DistanceGrid(np.minimum(values, grid.values), grid.origin, grid.cell)  # rounded nowhere above


def _ways(motion: Motion, corners: Float[np.ndarray, "x y z 3"], cell: float) -> Float[np.ndarray, " pose"]:
    """Return ways [m] along a motion between which no corner moves farther than a cell."""
    box = corners[:: len(corners) - 1, :: corners.shape[1] - 1, :: corners.shape[2] - 1].reshape(-1, 3)
    ways = [np.zeros(1)]
    for start, end in pairwise([*motion.beginnings, motion.length]):
        fastest = np.linalg.norm(motion.twist(start).velocity(box), axis=1).max() if start < motion.turn_length else 1.0
        ways.append(np.linspace(start, end, 1 + int(np.ceil((end - start) * fastest / cell)))[1:])
    return np.concatenate(ways)


@wp.kernel(enable_backward=False)
def least_distances(
    first: int,
    grids: PackedGrids,
    poses: wp.array(dtype=wp.mat44),
    step: float,
    relevant: float,
    points: wp.array(dtype=wp.vec3),
    least: wp.array(dtype=float),
):
    """One point: the least distance [m] over all poses, which move it by at most `step` [m] from one to the next."""
    i = first + wp.tid()
    found = grid_distance(grids.headers[0], grids.values, points[i])[0]
    pose = wp.int32(1)
    while pose < poses.shape[0]:
        p = wp.transform_point(poses[pose], points[i])
        looked_up = grids.headers[1]
        if inside_box(grids.headers[0], p):
            looked_up = grids.headers[0]
        distance = grid_distance(looked_up, grids.values, p)[0]
        found = wp.min(found, distance)
        # No nearer can be reached sooner: distances are 1-Lipschitz, looked up to within a cell.
        pose += wp.max(1, int((distance - wp.min(found, relevant)) / step) - 1)
    least[i] = found
