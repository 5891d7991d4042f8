"""The point cloud by which the diffusion model knows an object."""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

CANDIDATES_PER_POINT = 8  # random candidates offered for each point that will be kept
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
    sampled, faces = trimesh.sample.sample_surface(mesh, wanted, seed=np.random.default_rng(seed))
    used = np.unique(mesh.faces)
    used = used[np.argsort(-np.asarray(mesh.vertex_defects)[used], kind="stable")]
    candidates = np.concatenate([mesh.vertices[used], sampled])
    normals = np.concatenate([mesh.vertex_normals[used], mesh.face_normals[faces]])
    kept = dart_throwing(candidates, radius)
    return SurfacePoints(np.asarray(candidates[kept]), np.asarray(normals[kept]))


def dart_throwing(candidates: Float[np.ndarray, "n 3"], radius: float) -> np.ndarray:
    """Indices of a maximal subset, earliest first, whose members are more than `radius` [m] apart."""
    tree = cKDTree(candidates)
    free = np.ones(len(candidates), dtype=bool)
    kept = []
    for index in range(len(candidates)):
        if free[index]:
            kept.append(index)
            free[tree.query_ball_point(candidates[index], radius)] = False
    return np.asarray(kept, dtype=np.int64)


CLOUD_POINTS = 1024


def object_cloud(mesh: trimesh.Trimesh, *, seed: int = 0) -> Float[Tensor, "point 6"]:
    """1024 points [m] with outward normals, spread evenly over the surface, in the mesh's frame."""
    spacing = float(np.sqrt(mesh.area / CLOUD_POINTS))
    spread = surface_points(mesh, spacing=spacing, seed=seed)
    chosen = np.random.default_rng(seed).permutation(len(spread.points))
    chosen = np.resize(chosen, CLOUD_POINTS)
    return torch.as_tensor(np.concatenate([spread.points, spread.normals], axis=1)[chosen], dtype=torch.float32)
