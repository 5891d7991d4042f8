"""The point cloud by which the diffusion model knows an object."""

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from torch import Tensor

from dexnudge.geometry.surface_points import surface_points

CLOUD_POINTS = 1024


def object_cloud(mesh: trimesh.Trimesh, *, seed: int = 0) -> Float[Tensor, "point 6"]:
    """1024 points [m] with outward normals, spread evenly over the surface, in the mesh's frame."""
    spacing = float(np.sqrt(mesh.area / CLOUD_POINTS))
    spread = surface_points(mesh, spacing=spacing, seed=seed)
    chosen = np.random.default_rng(seed).permutation(len(spread.points))
    chosen = np.resize(chosen, CLOUD_POINTS)
    return torch.as_tensor(np.concatenate([spread.points, spread.normals], axis=1)[chosen], dtype=torch.float32)
