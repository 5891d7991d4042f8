"""Turning configurations and surface points about the vertical through the object's centre.

The resting frame turned by -yaw of the motion is the canonical frame C, in which the motion is +x.
"""

import torch
from jaxtyping import Float
from torch import Tensor


def turn_vectors(vectors: Float[Tensor, "*batch 3"], yaw: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3"]:
    """R_z(yaw) v; yaw [rad] is counter-clockwise seen from above and broadcasts against the batch."""
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    x, y, z = vectors.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y, z], dim=-1)


def turn_configurations(
    q: Float[Tensor, "*batch dimension"], yaw: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch dimension"]:
    """The hand carried around with the object: translation and both rotation columns turn, joint angles stay."""
    translation = turn_vectors(q[..., 0:3], yaw)
    first_column = turn_vectors(q[..., 3:6], yaw)
    second_column = turn_vectors(q[..., 6:9], yaw)
    return torch.cat([translation, first_column, second_column, q[..., 9:]], dim=-1)


def turn_clouds(
    clouds: Float[Tensor, "object point 6"], yaw: Float[Tensor, " object"]
) -> Float[Tensor, "object point 6"]:
    """Points [m] and normals, one yaw per object."""
    points = turn_vectors(clouds[..., :3], yaw[:, None])
    normals = turn_vectors(clouds[..., 3:], yaw[:, None])
    return torch.cat([points, normals], dim=-1)
