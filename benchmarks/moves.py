"""Moves of hands written out in torch: what the descent's kernel does in one step, for references of it."""

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.descent import HandPose
from dexnudge.hands.hand import ROOT_COORDINATES, Hand


def rotation_vector_to_matrix(rotation_vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Exponential map so(3) -> SO(3) by Rodrigues' formula; rotation_vector = axis * angle [rad]."""
    angle = rotation_vector.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    x, y, z = (rotation_vector / angle).unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    sine, cosine = angle.sin()[..., None], angle.cos()[..., None]
    identity = torch.eye(3, dtype=skew.dtype, device=skew.device)
    return identity + sine * skew + (1 - cosine) * (skew @ skew)


def retract(hand: Hand, pose: HandPose, move: Float[Tensor, "batch tangent"], *, tied: bool = False) -> HandPose:
    """Return the pose moved along a tangent: translation added, rotation vector applied (working frame), angles clamped.

    With `tied` both joints of each tendon turn alike.
    """
    rotation = rotation_vector_to_matrix(move[:, 3:6]) @ pose.rotation
    q = torch.cat([move.new_zeros(len(move), ROOT_COORDINATES), pose.joint_angles + move[:, 6:]], dim=1)
    q = hand.equalise_tendon_joints(q) if tied else hand.clamp(q)
    return HandPose(pose.translation + move[:, :3], rotation, q[:, ROOT_COORDINATES:])
