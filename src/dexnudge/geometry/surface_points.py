"""Evenly spread points on a surface: those of a hand's links, and the cloud by which the model knows an object."""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.geometry.disk_cache import cached_array
from dexnudge.geometry.warp_runtime import wp

CANDIDATES_PER_POINT = 8  # random candidates offered for each point that will be kept
PIECE = 2**14  # candidates that are placed at once
FORMAT = "dexnudge surface points 1"  # another number for other points on the same mesh
GRID_CELLS = (64, 64, 64)  # of the table in which neighbours are looked up; what lies farther apart shares its cells
DISC_PACKING = 0.7  # points kept by dart throwing per (area / radius^2)


@dataclass(frozen=True)
class SurfacePoints:
    """Points [m] on a mesh and the outward unit normals there, in the mesh's frame."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]


def surface_points(mesh: trimesh.Trimesh, *, spacing: float, seed: int = 0) -> SurfacePoints:
    """Poisson-disc points, no two closer together than `spacing` / sqrt(2) [m].

    98 % of the surface lies within `spacing` / sqrt(2) of a point, all of it within 1.1 `spacing`. Dart throwing over many
    candidates, the sharp vertices first because the deepest penetration sits there.
    """
    if len(mesh.faces) == 0:
        return SurfacePoints(np.zeros((0, 3)), np.zeros((0, 3)))
    radius = spacing / np.sqrt(2.0)
    wanted = int(CANDIDATES_PER_POINT * DISC_PACKING * mesh.area / radius**2) + 64
    candidates, faces = random_points(mesh, wanted, np.random.default_rng(seed))
    used = np.unique(mesh.faces)
    used = used[np.argsort(-np.asarray(mesh.vertex_defects)[used], kind="stable")]
    candidates = np.concatenate([mesh.vertices[used], candidates])
    kept = dart_throwing(candidates, radius)
    corners, between = np.split(kept, [np.searchsorted(kept, len(used))])
    normals = np.concatenate([mesh.vertex_normals[used[corners]], mesh.face_normals[faces[between - len(used)]]])
    return SurfacePoints(np.asarray(candidates[kept]), np.asarray(normals))


def random_points(
    mesh: trimesh.Trimesh, count: int, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "count 3"], Int[np.ndarray, " count"]]:
    """Return points spread evenly at random, and their triangles: those of `trimesh.sample`, in an eighth of its memory."""
    areas = np.cumsum(mesh.area_faces)
    faces = np.searchsorted(areas, generator.random(count) * areas[-1])
    along = generator.random((count, 2, 1))
    along[along.sum(axis=1).reshape(-1) > 1.0] -= 1.0  # from the far half of the parallelogram back into the triangle
    np.abs(along, out=along)
    corners = np.asarray(mesh.triangles)
    points = np.empty((count, 3))
    for begin in range(0, count, PIECE):
        these = slice(begin, begin + PIECE)
        first = corners[faces[these], :1]
        sides = corners[faces[these], 1:] - first
        points[these] = (sides * along[these]).sum(axis=1) + first[:, 0]
    return points, faces


def cached_surface_points(mesh: trimesh.Trimesh, *, spacing: float, seed: int = 0) -> SurfacePoints:
    """`surface_points`, bit by bit, read from the cache if they are there: for meshes that are used again and again."""
    # NumPy draws the candidates and trimesh tells the areas: another version may do it differently.
    kind = f"{FORMAT} numpy {np.__version__} trimesh {trimesh.__version__}"

    def make() -> Float[np.ndarray, "n 6"]:
        spread = surface_points(mesh, spacing=spacing, seed=seed)
        return np.concatenate([spread.points, spread.normals], axis=1)

    # The normals, too: those of a file may differ in the last bits from what its corners say.
    inputs = [mesh.vertices, mesh.faces, mesh.vertex_normals, mesh.face_normals, np.array([spacing, seed])]
    points, normals = np.hsplit(cached_array(kind, [np.asarray(each) for each in inputs], make), 2)
    return SurfacePoints(np.ascontiguousarray(points), np.ascontiguousarray(normals))


@wp.kernel(enable_backward=False)
def _throw_darts(grid: wp.uint64, points: wp.array(dtype=wp.vec3d), radius: wp.float64, kept: wp.array(dtype=wp.uint8)):
    """One thread: whether each point is farther than `radius` from every earlier one that is kept."""
    for i in range(points.shape[0]):
        if kept[i] == wp.uint8(1):
            for other in wp.hash_grid_query(grid, points[i], radius):
                if other > i and wp.length_sq(points[other] - points[i]) <= radius * radius:
                    kept[other] = wp.uint8(0)


def dart_throwing(candidates: Float[np.ndarray, "n 3"], radius: float) -> Int[np.ndarray, " kept"]:
    """Return indices of a maximal subset, earliest first, whose members are more than `radius` [m] apart."""
    points = wp.array(candidates, dtype=wp.vec3d, device="cpu", copy=False)
    kept = wp.ones(len(candidates), dtype=wp.uint8, device="cpu")
    grid = wp.HashGrid(*GRID_CELLS, device="cpu", dtype=wp.float64)
    grid.build(points, radius)
    wp.launch(_throw_darts, dim=1, inputs=[grid.id, points, wp.float64(radius), kept], device="cpu")
    return np.flatnonzero(kept.numpy())


CLOUD_POINTS = 1024


def object_cloud(mesh: trimesh.Trimesh) -> Float[Tensor, "point 6"]:
    """1024 points [m] with outward normals, spread evenly over the surface, in the mesh's frame."""
    spacing = float(np.sqrt(mesh.area / CLOUD_POINTS))
    spread = surface_points(mesh, spacing=spacing)
    chosen = np.random.default_rng(0).permutation(len(spread.points))
    chosen = np.resize(chosen, CLOUD_POINTS)
    return torch.from_numpy(np.concatenate([spread.points, spread.normals], axis=1)[chosen]).float()
