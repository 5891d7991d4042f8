"""A batch of hands: configurations, and where they put links and surface points."""

from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.errors import InputError, check_kind
from dexnudge.hands.hand import ROOT_COORDINATES, Hand


class HandBatch:
    """Hands of one kind in one frame, the world's unless said otherwise; what follows from q is computed on first use.

    Everything is differentiable in `q`.

    Args:
        hand: the kind of hand.
        q: (n, 9 + d) floating-point tensor, [translation (3) [m] | 6D rotation (6) | joint angles (d) [rad], sliding
            ones [m]], one row for each hand; an array is made into a tensor. Points and poses have its dtype.
        dense: whether `points` are those that judge (at most 2 mm apart), instead of the sparse ones that guide.

    Attributes:
        hand: the kind of hand.
        q: the configurations.
        derived: what others have computed from this batch, kept as long as it lives.

    Raises:
        InputError: `q` is not of shape (n, 9 + d), or holds no floating-point numbers.
    """

    def __init__(
        self,
        hand: Hand,
        q: Float[Tensor, "batch coordinates"] | Float[np.ndarray, "batch coordinates"],
        *,
        dense: bool = False,
    ) -> None:
        check_kind("hand", hand, Hand, 'load_hand("shadow_lite")')
        coordinates = ROOT_COORDINATES + hand.num_joints
        if not isinstance(q, Tensor):
            q = torch.as_tensor(np.asarray(q), device="cpu")
        if q.ndim != 2 or q.shape[1] != coordinates or not q.is_floating_point():
            raise InputError(
                f"`q` is {q.dtype} of shape {tuple(q.shape)}; hand '{hand.name}' expects floating-point numbers of shape "
                f"(n, {coordinates})"
            )
        self.hand, self.q = hand, q
        self.derived: dict[Any, Any] = {}
        self._surface = hand.dense_points if dense else hand.sparse_points

    def __len__(self) -> int:
        return len(self.q)

    def __repr__(self) -> str:
        return f"HandBatch({len(self)} x {self.hand.name})"

    @property
    def joint_angles(self) -> Float[Tensor, "batch joint"]:
        """Joint angles [rad], of sliding joints [m], in the order of `hand.joint_names`."""
        return self.q[:, ROOT_COORDINATES:]

    @cached_property
    def T_world_link(self) -> Float[Tensor, "batch link 4 4"]:
        """Pose of every link, in the order of `hand.link_names`."""
        return self.hand.forward_kinematics(self.q)

    @cached_property
    def point_links(self) -> Int[Tensor, " point"]:
        """Index of the link that each of `points` belongs to."""
        return torch.as_tensor(self._surface.link, dtype=torch.int64, device=self.q.device)

    @cached_property
    def points(self) -> Float[Tensor, "batch point 3"]:
        """Points on the surfaces of all links [m]."""
        own = torch.as_tensor(self._surface.points, dtype=self.q.dtype, device=self.q.device)
        counts = np.bincount(self._surface.link, minlength=len(self.hand.link_names)).tolist()
        # Link by link: a gathered pose for each point would take ten times as long to differentiate.
        placed = [
            points @ self.T_world_link[:, link, :3, :3].transpose(1, 2) + self.T_world_link[:, link, None, :3, 3]
            for link, points in enumerate(own.split(counts))
            if len(points)
        ]
        return torch.cat(placed, dim=1)
