"""The energies in plain torch as in DexGraspNet: pytorch_kinematics, grid_sample, autograd; what ours is timed against.

The definition is that of the fused kernel. No bounding volumes, as usual there; but points are looked up only in the grids
whose box they are in, and all links that are tested against one link go through one call.
"""

import tempfile
from pathlib import Path

import numpy as np
import pytorch_kinematics as kinematics
import torch
from jaxtyping import Bool, Float
from moves import rotation_vector_to_matrix
from torch import Tensor
from torch.nn.functional import grid_sample

from dexnudge.energies.descent import HandPose
from dexnudge.energies.kernel_inputs import build_hand_model
from dexnudge.energies.terms import TermWeights
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.export import export_hand
from dexnudge.hands.hand import Hand

OBJECT, NEAR, FAR = range(3)  # grids of a scene
OUTSIDE = 0.01  # [cells] beyond the box, where the way to it is added: as in the kernel


class TorchGrid:
    """One distance grid as torch samples it."""

    def __init__(self, header: np.void, values: Float[np.ndarray, " all"]) -> None:
        shape = [int(header[name]) for name in ("nx", "ny", "nz")]
        start = int(header["start"])
        own = values[start : start + int(np.prod(shape))].reshape(shape)
        self.values = torch.as_tensor(own)[None, None]
        self.cell = float(header["cell"])
        self.low = torch.as_tensor(np.asarray(header["origin"], dtype=np.float32))
        self.size = self.cell * (torch.tensor(shape, dtype=torch.float32) - 1)

    def holds(self, points: Float[Tensor, "... 3"]) -> Bool[Tensor, "..."]:
        """Which points are in the box."""
        inner = points.detach() - self.low
        return ((inner >= 0) & (inner <= self.size)).all(dim=-1)

    def sample(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Trilinear values at points in the box [m]."""
        place = 2 * (points - self.low) / self.size - 1
        # grid_sample's x is the last axis of the values.
        found = grid_sample(self.values, place.flip(-1)[None, None, None], padding_mode="border", align_corners=True)
        return found[0, 0, 0, 0]

    def everywhere(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Values in the box; outside, the value at its nearest point and the way there."""
        nearest = self.low + torch.minimum((points - self.low).clamp_min(0.0), self.size)
        value, gap = self.sample(nearest), (points - nearest.detach()).norm(dim=-1)
        return torch.where(gap > OUTSIDE * self.cell, value.detach() + gap, value)


class TorchEnergy:
    """Energy of each hand, differentiable in the pose."""

    def __init__(self, hand: Hand, fields: WarpStruct, weights: TermWeights) -> None:
        model = build_hand_model(hand)
        self.hand, self.weights = hand, weights
        with tempfile.TemporaryDirectory() as folder:
            urdf = Path(export_hand(hand, folder)).read_bytes()
        self.chain = kinematics.build_chain_from_urdf(urdf).to(dtype=torch.float32)
        self.order = [hand.joint_names.index(name) for name in self.chain.get_joint_parameter_names()]
        self.scene = [TorchGrid(header, fields.grids.values.numpy()) for header in fields.grids.headers.numpy()]
        self.links = [TorchGrid(header, model.grids.values.numpy()) for header in model.grids.headers.numpy()]
        starts = model.clusters.first.numpy()[model.first_cluster.numpy()]
        counts = np.diff(starts)
        self.points = torch.as_tensor(model.points.numpy())
        self.link = torch.as_tensor(np.repeat(np.arange(len(counts)), counts))
        self.solid = [link for link, count in enumerate(counts) if count]
        self.fixed = [torch.as_tensor(p.numpy()) for p in (fields.object_points, fields.environment_points)]
        self.has_environment = bool(fields.has_environment)
        partners: list[list[int]] = [[] for _ in counts]
        for one, other in hand.self_collision_pairs:
            partners[one].append(other)
            partners[other].append(one)
        self.tested = [torch.cat([torch.where(self.link == p)[0] for p in own] or [self.link[:0]]) for own in partners]

    def __call__(
        self, pose: HandPose, tangent: Float[Tensor, "batch tangent"], contact_weight: Float[Tensor, "batch link"]
    ) -> Float[Tensor, "batch 4"]:
        """(environment, object, self, contact) of each hand, at the pose moved along the tangent."""
        weights, batch = self.weights, len(tangent)
        rotation = rotation_vector_to_matrix(tangent[:, 3:6]) @ pose.rotation
        translation = pose.translation + tangent[:, :3]
        frames = self.chain.forward_kinematics((pose.joint_angles + tangent[:, 6:])[:, self.order])
        local = torch.stack([frames[name].get_matrix().expand(batch, 4, 4) for name in self.hand.link_names], dim=1)
        turn = rotation[:, None] @ local[:, :, :3, :3]
        shift = (rotation[:, None] @ local[:, :, :3, 3:])[..., 0] + translation[:, None]
        points = torch.cat(
            [self.points[self.link == k] @ turn[:, k].transpose(1, 2) + shift[:, k, None] for k in self.solid], dim=1
        )
        to_object = self.scene[OBJECT].everywhere(points.reshape(-1, 3)).reshape(batch, -1)
        inside = weights.object * (weights.clearance_object - to_object).clamp_min(0).square().sum(dim=1)
        around = points.new_zeros(batch)
        if self.has_environment:
            hinge = (weights.clearance_environment - self.environment(points.reshape(-1, 3))).clamp_min(0)
            around = weights.environment * hinge.square().reshape(batch, -1).sum(dim=1)
        own, contact = points.new_zeros(batch), points.new_zeros(batch)
        for link in self.solid:
            back = turn[:, link], shift[:, link]
            inside = inside + weights.object * self.depth(link, self.fixed[0], back, weights.clearance_object)
            around = around + weights.environment * self.depth(link, self.fixed[1], back, weights.clearance_environment)
            own = own + weights.self * self.depth(link, points[:, self.tested[link]], back, weights.clearance_self)
            if (contact_weight[:, link] > 0).any():
                gap = to_object[:, self.link == link].amin(dim=1) - weights.contact_gap
                contact = contact + weights.contact * contact_weight[:, link] * gap.square()
        return torch.stack([around, inside, own, contact], dim=1)

    def environment(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Distance to the environment: from the near grid where its box holds the point, from the far one elsewhere."""
        near = self.scene[NEAR].holds(points)
        distance = points.new_zeros(len(points))
        distance = distance.index_put((near,), self.scene[NEAR].sample(points[near]))
        return distance.index_put((~near,), self.scene[FAR].everywhere(points[~near]))

    def depth(
        self,
        link: int,
        points: Float[Tensor, "... 3"],
        frame: tuple[Float[Tensor, "batch 3 3"], Float[Tensor, "batch 3"]],
        clearance: float,
    ) -> Float[Tensor, " batch"]:
        """Sum of squared depths of points in a link, from `clearance` outside its surface on."""
        local = (points - frame[1][:, None]) @ frame[0]
        held = self.links[link].holds(local)
        hinge = (clearance - self.links[link].sample(local[held])).clamp_min(0)
        return points.new_zeros(len(local)).index_add(0, torch.where(held)[0], hinge.square())
