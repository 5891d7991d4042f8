"""The conditional denoiser, PointNet over the object and diffusion transformer over the hand, and the normaliser of q.

x_t is cut into tokens by the architecture's token layout. Time, object, class and motion are summed into one vector
that scales, shifts and gates every layer (adaLN-Zero; Peebles and Xie, 2023).
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from dexnudge.diffusion.config import ModelConfig, token_parts
from dexnudge.geometry.transforms import matrix_to_rotation_6d, rotation_6d_to_matrix
from dexnudge.hands.hand import SLIDE_SCALE

CLASSES = ("grasp", "non_prehensile", "null")  # null stands where the class was dropped for classifier-free guidance
GRASP, NON_PREHENSILE, NULL_CLASS = range(3)


@dataclass(frozen=True)
class Condition:
    """One row for all samples, or one row a sample.

    object_feature: from `ConditionalDenoiser.encode`, of a cloud in frame C; behaviour: index into CLASSES;
    twist: of the object's motion in frame C, linear [m/m] at its origin and angular [rad/m], see `Twist`; a slide is +x,
    zeros if there is no motion; has_twist: whether it counts.
    """

    object_feature: Float[Tensor, "row feature"]
    behaviour: Int[Tensor, " row"]
    twist: Float[Tensor, "row 6"]
    has_twist: Bool[Tensor, " row"]

    @property
    def inputs(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What the network takes after x_t and t."""
        return self.object_feature, self.behaviour, self.twist, self.has_twist

    def without_intent(self) -> "Condition":
        """Return the same object, with class and motion dropped: the reference of classifier-free guidance."""
        return Condition(
            object_feature=self.object_feature,
            behaviour=torch.full_like(self.behaviour, NULL_CLASS),
            twist=torch.zeros_like(self.twist),
            has_twist=torch.zeros_like(self.has_twist),
        )


MIN_TRANSLATION_STD = 5e-3  # [m] keeps a coordinate that hardly varies in the data from being blown up
MIN_JOINT_STD = 5e-2  # [rad of `Hand.joint_scales`] the same for joint angles
ROTATION_STD = 3.0**-0.5  # of one entry of a uniformly random unit vector; no mean, so that rotating stays rotating


@dataclass(frozen=True)
class Normaliser:
    """x = (q - mean) / std, entry by entry; mean and std have the units of q, frame C.

    The six rotation entries share mean 0 and std 1/sqrt(3) whatever the data.
    """

    mean: Float[Tensor, " dimension"]
    std: Float[Tensor, " dimension"]

    @classmethod
    def fit(
        cls, q: Float[Tensor, "row dimension"], *, sliding: Bool[np.ndarray, " joint"] | None = None
    ) -> "Normaliser":
        """Return the statistics of configurations in frame C; entries of `sliding` joints are in metres, None: of none."""
        mean, std = q.double().mean(dim=0), q.double().std(dim=0, correction=0)
        mean[3:9], std[3:9] = 0.0, ROTATION_STD
        std[:3].clamp_(min=MIN_TRANSLATION_STD)
        scales = np.ones(q.shape[1] - 9) if sliding is None else np.where(sliding, SLIDE_SCALE, 1.0)
        std[9:] = torch.maximum(std[9:], MIN_JOINT_STD * torch.as_tensor(scales))
        return cls(mean=mean.float(), std=std.float())

    def normalise(self, q: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        """Return x for q in frame C."""
        return (q - self.mean) / self.std

    def denormalise(self, x: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        """Return q in frame C for x, with a proper rotation (Gram-Schmidt on its two columns); differentiable.

        Joint angles may lie outside their limits.
        """
        q = x * self.std + self.mean
        rotation = matrix_to_rotation_6d(rotation_6d_to_matrix(q[:, 3:9]))
        return torch.cat([q[:, :3], rotation, q[:, 9:]], dim=-1)

    def to(self, device: torch.device | str) -> "Normaliser":
        """Return the same on another device."""
        return Normaliser(mean=self.mean.to(device), std=self.std.to(device))


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


TIME_FREQUENCIES = 64  # sine and cosine pairs of the timestep embedding
LONGEST_PERIOD = 10_000.0  # of the timestep embedding, in steps
TURN_SCALE = 0.1  # [m] an object's farthest point is about so far from its axis: brings angular parts to the order of 1


class ConditionalDenoiser(nn.Module):
    """Predicts x_0, epsilon or v from x_t (see `NoiseSchedule`), given the object's feature, class and motion.

    The last layer and all gates start at zero: an untrained network returns zero for every input. So do the columns for the
    angular part of a twist, in networks that were only trained on slides as well.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        shape = config.architecture
        width = shape.width
        parts = token_parts(shape.token_layout, config.joint_groups)
        order = [index for part in parts for index in part]
        self.part_sizes = [len(part) for part in parts]
        self.order: Tensor
        self.inverse_order: Tensor
        self.register_buffer("order", torch.tensor(order), persistent=False)
        self.register_buffer("inverse_order", torch.argsort(torch.tensor(order)), persistent=False)
        self.encoder = PointEncoder(shape.encoder_widths, shape.feature_width)
        self.token_in = nn.ModuleList(nn.Linear(size, width) for size in self.part_sizes)
        self.token_position = nn.Parameter(0.02 * torch.randn(len(parts), width))
        self.time_embedding = nn.Sequential(nn.Linear(2 * TIME_FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))
        self.object_embedding = nn.Linear(shape.feature_width, width)
        self.class_embedding = nn.Embedding(len(CLASSES), width)
        self.direction_embedding = nn.Linear(4, width)
        self.turn_embedding = nn.Parameter(torch.zeros(width, 3))
        self.modulation = nn.Linear(width, (6 * shape.depth + 2) * width)
        self.blocks = nn.ModuleList(
            TransformerBlock(width, shape.num_heads, shape.mlp_ratio) for _ in range(shape.depth)
        )
        self.token_out = nn.ModuleList(nn.Linear(width, size) for size in self.part_sizes)
        for layer in (self.modulation, *self.token_out):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def encode(self, points: Float[Tensor, "object point 6"]) -> Float[Tensor, "object feature"]:
        """Return the object feature of points [m] and unit normals in frame C; the order of the points does not matter."""
        return self.encoder(points)

    def forward(
        self,
        x_t: Float[Tensor, "batch dimension"],
        t: Int[Tensor, " row"],
        object_feature: Float[Tensor, "row feature"],
        behaviour: Int[Tensor, " row"],
        twist: Float[Tensor, "row 6"],
        has_twist: Bool[Tensor, " row"],
    ) -> Float[Tensor, "batch dimension"]:
        """Return the prediction for normalised x_t; row = batch, or 1 where all samples share timestep and condition."""
        flag = has_twist[:, None].to(x_t.dtype)
        linear, angular = (twist * flag).split(3, dim=-1)
        condition = (
            self.time_embedding(timestep_features(t).to(x_t.dtype))
            + self.object_embedding(object_feature)
            + self.class_embedding(behaviour)
            + self.direction_embedding(torch.cat([linear, flag], dim=-1))
            + functional.linear(TURN_SCALE * angular, self.turn_embedding)
        )
        modulation = self.modulation(functional.silu(condition))[:, None].chunk(6 * len(self.blocks) + 2, dim=-1)
        parts = x_t[:, self.order].split(self.part_sizes, dim=-1)
        tokens = torch.stack([layer(part) for layer, part in zip(self.token_in, parts, strict=True)], dim=1)
        tokens = tokens + self.token_position
        for index, block in enumerate(self.blocks):
            tokens = block(tokens, *modulation[6 * index : 6 * index + 6])
        tokens = modulate(tokens, *modulation[-2:])
        outputs = [layer(token) for layer, token in zip(self.token_out, tokens.unbind(1), strict=True)]
        return torch.cat(outputs, dim=-1)[:, self.inverse_order]


class TransformerBlock(nn.Module):
    """Self-attention and MLP over the tokens, each scaled, shifted and gated by the condition."""

    def __init__(self, width: int, num_heads: int, mlp_ratio: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.qkv = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, mlp_ratio * width), nn.GELU(), nn.Linear(mlp_ratio * width, width))

    def forward(
        self,
        tokens: Float[Tensor, "batch token width"],
        *modulation: Float[Tensor, "row 1 width"],
    ) -> Float[Tensor, "batch token width"]:
        """Same shape as `tokens`, and equal to them where both gates are zero.

        modulation: shift, scale and gate of the attention, then of the MLP.
        """
        shift_attention, scale_attention, gate_attention, shift_mlp, scale_mlp, gate_mlp = modulation
        attended = self.attend(modulate(tokens, shift_attention, scale_attention))
        tokens = torch.addcmul(tokens, gate_attention, attended)
        return torch.addcmul(tokens, gate_mlp, self.mlp(modulate(tokens, shift_mlp, scale_mlp)))

    def attend(self, tokens: Float[Tensor, "batch token width"]) -> Float[Tensor, "batch token width"]:
        """Return multi-head self-attention without mask."""
        batch, num_tokens, width = tokens.shape
        if num_tokens == 1:  # a single score has softmax 1: what comes out is the value
            return self.attention_out(functional.linear(tokens, self.qkv.weight[-width:], self.qkv.bias[-width:]))
        heads = self.qkv(tokens).view(batch, num_tokens, 3, self.num_heads, width // self.num_heads)
        query, key, value = heads.permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(query, key, value)
        return self.attention_out(mixed.transpose(1, 2).reshape(batch, num_tokens, width))


def modulate(
    tokens: Float[Tensor, "batch token width"], shift: Float[Tensor, "row 1 width"], scale: Float[Tensor, "row 1 width"]
) -> Float[Tensor, "batch token width"]:
    """Return LayerNorm without its own parameters, then (1 + scale) x + shift."""
    return torch.addcmul(shift, functional.layer_norm(tokens, tokens.shape[-1:]), 1.0 + scale)


def timestep_features(t: Int[Tensor, " row"]) -> Float[Tensor, "row frequency"]:
    """Return sines and cosines of t at geometrically spaced frequencies (Vaswani et al., 2017)."""
    exponents = torch.arange(TIME_FREQUENCIES, dtype=torch.float32, device=t.device) / TIME_FREQUENCIES
    angles = t.float()[:, None] * torch.exp(-math.log(LONGEST_PERIOD) * exponents)
    return torch.cat([angles.cos(), angles.sin()], dim=-1)
