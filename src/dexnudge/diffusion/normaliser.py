"""Between a hand configuration in metres and radians and the unit-scale vector that is diffused."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.geometry.transforms import matrix_to_rotation_6d, rotation_6d_to_matrix

MIN_TRANSLATION_STD = 5e-3  # [m] keeps a coordinate that hardly varies in the data from being blown up
MIN_JOINT_STD = 5e-2  # [rad] the same for joint angles
ROTATION_STD = 3.0**-0.5  # of one entry of a uniformly random unit vector; no mean, so that rotating stays rotating


@dataclass(frozen=True)
class Normaliser:
    """x = (q - mean) / std, entry by entry; mean and std have the units of q, frame C.

    The six rotation entries share mean 0 and std 1/sqrt(3) whatever the data.
    """

    mean: Float[Tensor, " dimension"]
    std: Float[Tensor, " dimension"]

    @classmethod
    def fit(cls, q: Float[Tensor, "row dimension"]) -> "Normaliser":
        """Statistics of configurations in frame C."""
        mean, std = q.double().mean(dim=0), q.double().std(dim=0, correction=0)
        mean[3:9], std[3:9] = 0.0, ROTATION_STD
        std[:3].clamp_(min=MIN_TRANSLATION_STD)
        std[9:].clamp_(min=MIN_JOINT_STD)
        return cls(mean=mean.float(), std=std.float())

    def normalise(self, q: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        """q in frame C to x."""
        return (q - self.mean) / self.std

    def denormalise(self, x: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        """x to q in frame C, with a proper rotation (Gram-Schmidt on its two columns); differentiable."""
        q = x * self.std + self.mean
        rotation = matrix_to_rotation_6d(rotation_6d_to_matrix(q[:, 3:9]))
        return torch.cat([q[:, :3], rotation, q[:, 9:]], dim=-1)

    def to(self, device: torch.device | str) -> "Normaliser":
        """The same on another device."""
        return Normaliser(mean=self.mean.to(device), std=self.std.to(device))
