"""A PointNet (Qi et al., 2017) over the object's surface, with its support function beside it."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

POINT_SCALE = 10.0  # objects span 2 cm to 60 cm: decimetres bring them to the order of 1
SUPPORT_DIRECTIONS = 24  # planar directions, every 15 degrees; up and down come on top


class PointEncoder(nn.Module):
    """feature = MLP([max over points of a per-point MLP | max over points of <p, u_k>]).

    The second part is the support function of the point set along fixed unit vectors u_k: how far the object reaches in
    each planar direction, up and down. It says where the rims are, which the pooled part would have to learn.
    """

    def __init__(self, widths: tuple[int, ...], feature_width: int) -> None:
        super().__init__()
        self.point_layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise((6, *widths)))
        pooled = widths[-1] + SUPPORT_DIRECTIONS + 2
        self.head = nn.Sequential(nn.Linear(pooled, feature_width), nn.SiLU(), nn.Linear(feature_width, feature_width))
        angles = torch.arange(SUPPORT_DIRECTIONS) * (2.0 * torch.pi / SUPPORT_DIRECTIONS)
        planar = torch.stack([angles.cos(), angles.sin(), torch.zeros_like(angles)], dim=0)
        vertical = torch.tensor([[0.0, 0.0], [0.0, 0.0], [1.0, -1.0]])
        self.support_directions: Tensor
        self.register_buffer("support_directions", torch.cat([planar, vertical], dim=1), persistent=False)

    def forward(self, points: Float[Tensor, "object point 6"]) -> Float[Tensor, "object feature"]:
        """points: position [m] and unit normal, in the frame in which the feature is wanted."""
        position = points[..., :3] * POINT_SCALE
        hidden = torch.cat([position, points[..., 3:]], dim=-1)
        for layer in self.point_layers[:-1]:
            hidden = functional.relu(layer(hidden))
        pooled = self.point_layers[-1](hidden).amax(dim=1)
        support = (position @ self.support_directions).amax(dim=1)
        return self.head(torch.cat([pooled, support], dim=-1))
