"""Starts that need no model: random hands around the object."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.geometry.transforms import matrix_to_rotation_6d
from dexnudge.hands.hand import Hand

DISTANCE = (0.03, 0.16)  # [m] of the palm from a point of the object
TILT = 0.6  # [rad] standard deviation of the palm's facing about the direction to that point
MEAN_FLEXION, FLEXION_SPREAD = 0.4, 0.2  # of a joint's range


def random_start(
    hand: Hand, cloud: Float[Tensor, "point 6"], *, count: int, generator: torch.Generator
) -> Float[Tensor, "count coordinates"]:
    """Return configurations in the frame of `cloud`: any direction from the object above its support, palm toward it."""

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator, device="cpu")

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, device="cpu")

    aim = cloud[torch.randint(len(cloud), (count,), generator=generator, device="cpu"), :3]
    outward = torch.nn.functional.normalize(normal(count, 3), dim=1)
    outward[:, 2].abs_()
    facing = torch.nn.functional.normalize(-outward + TILT * normal(count, 3), dim=1)
    helper = torch.nn.functional.normalize(torch.linalg.cross(facing, normal(count, 3)), dim=1)
    wanted = torch.stack([torch.linalg.cross(facing, helper, dim=1), facing, helper], dim=2)
    palm_normal = hand.palm_normal / np.linalg.norm(hand.palm_normal)
    own = np.stack([np.cross(palm_normal, hand.finger_axis), palm_normal, hand.finger_axis], axis=1)
    rotation = wanted @ torch.from_numpy(own.T).float()
    reach = torch.from_numpy(hand.finger_middle).float()
    translation = aim + uniform(*DISTANCE, count, 1) * outward - rotation @ reach

    lower, upper = (torch.from_numpy(limit).float() for limit in (hand.lower, hand.upper))
    joint_angles = lower + (upper - lower) * (MEAN_FLEXION + FLEXION_SPREAD * normal(count, hand.num_joints))
    q = torch.cat([translation, matrix_to_rotation_6d(rotation), joint_angles], dim=1)
    return hand.clamp(q)
