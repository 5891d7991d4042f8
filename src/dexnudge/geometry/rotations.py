"""Rotations as matrices and as the continuous 6D representation (Zhou et al., CVPR 2019).

The six numbers are the first two COLUMNS of R, stacked: [R e_x | R e_y].
"""

import torch
from jaxtyping import Float
from torch import Tensor


def rotation_6d_to_matrix(rotation_6d: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """Proper rotation by Gram-Schmidt on the two stored columns; differentiable; unique unless they are parallel."""
    first, second = rotation_6d[..., :3], rotation_6d[..., 3:]
    x = torch.nn.functional.normalize(first, dim=-1)
    y = torch.nn.functional.normalize(second - (x * second).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y, dim=-1)], dim=-1)


def matrix_to_rotation_6d(matrix: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 6"]:
    """First two columns of R, stacked."""
    return torch.cat([matrix[..., :, 0], matrix[..., :, 1]], dim=-1)


def rotation_vector_to_matrix(rotation_vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Exponential map so(3) -> SO(3) by Rodrigues' formula; rotation_vector = axis * angle [rad]."""
    angle = rotation_vector.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    x, y, z = (rotation_vector / angle).unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    sine, cosine = angle.sin()[..., None], angle.cos()[..., None]
    identity = torch.eye(3, dtype=skew.dtype, device=skew.device)
    return identity + sine * skew + (1 - cosine) * (skew @ skew)
