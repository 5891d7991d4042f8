"""Rotations, and the canonical frame of an object that lies on something."""

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from torch import Tensor


def rotation_6d_to_matrix(rotation_6d: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """Proper rotation by Gram-Schmidt on the two stored columns; differentiable; unique unless they are parallel."""
    first, second = rotation_6d[..., :3], rotation_6d[..., 3:]
    x = torch.nn.functional.normalize(first, dim=-1)
    y = torch.nn.functional.normalize(second - (x * second).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y, dim=-1)], dim=-1)


def matrix_to_rotation_6d(matrix: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 6"]:
    """Return the first two columns of R, stacked."""
    return torch.cat([matrix[..., :, 0], matrix[..., :, 1]], dim=-1)


PARALLEL = 0.99  # |cosine| above which a motion counts as vertical


def resting_origin(mesh: trimesh.Trimesh) -> Float[np.ndarray, " 3"]:
    """Return the origin of the resting frame [m], in the frame of `mesh` whose z axis is up.

    x, y: centroid of the convex hull, which turns with the object about z; z: half way up.
    """
    centre = np.asarray(mesh.convex_hull.center_mass)
    return np.asarray([centre[0], centre[1], mesh.bounds[:, 2].mean()])


def canonical_frame(object_in_world: trimesh.Trimesh, motion: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """T_world_canonical: x along the motion (unit, world), z the world's up made perpendicular to it.

    The origin is the resting origin of the object in the axes of this frame. For a vertical motion x is the world's x.
    """
    up = np.asarray([0.0, 0.0, 1.0])
    x = np.asarray(motion, dtype=np.float64) if abs(motion @ up) < PARALLEL else np.asarray([1.0, 0.0, 0.0])
    z = up - (up @ x) * x
    z /= np.linalg.norm(z)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    turned = object_in_world.copy().apply_transform(np.linalg.inv(frame))
    frame[:3, 3] = frame[:3, :3] @ resting_origin(turned)
    return frame


def transform_configurations(
    T_new_old: Float[np.ndarray, "4 4"], q: Float[np.ndarray, "n coordinates"]
) -> Float[np.ndarray, "n coordinates"]:
    """Return hand configurations given in another frame: the root moves, the joint angles stay."""
    moved = np.array(q, copy=True)
    rotation, translation = T_new_old[:3, :3], T_new_old[:3, 3]
    moved[:, :3] = q[:, :3] @ rotation.T + translation
    moved[:, 3:6] = q[:, 3:6] @ rotation.T
    moved[:, 6:9] = q[:, 6:9] @ rotation.T
    return moved
