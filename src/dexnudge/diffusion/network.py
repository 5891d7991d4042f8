"""The conditional denoiser: a PointNet over the object and a diffusion transformer over the parts of the hand.

x_t is cut into tokens by the architecture's token layout. Time, object, class and direction are summed into one vector
that scales, shifts and gates every layer (adaLN-Zero; Peebles and Xie, 2023).
"""

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from dexnudge.diffusion.conditioning import CLASSES
from dexnudge.diffusion.config import ModelConfig
from dexnudge.diffusion.point_encoder import PointEncoder
from dexnudge.diffusion.token_layout import token_parts

TIME_FREQUENCIES = 64  # sine and cosine pairs of the timestep embedding
LONGEST_PERIOD = 10_000.0  # of the timestep embedding, in steps


class ConditionalDenoiser(nn.Module):
    """Predicts x_0, epsilon or v from x_t (see `NoiseSchedule`), given the object's feature, class and direction.

    The last layer and all gates start at zero: an untrained network returns zero for every input.
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        shape = config.architecture
        width = shape.width
        parts = token_parts(shape.token_layout, config.digit_joints)
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
        self.modulation = nn.Linear(width, (6 * shape.depth + 2) * width)
        self.blocks = nn.ModuleList(
            TransformerBlock(width, shape.num_heads, shape.mlp_ratio) for _ in range(shape.depth)
        )
        self.token_out = nn.ModuleList(nn.Linear(width, size) for size in self.part_sizes)
        for layer in (self.modulation, *self.token_out):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def encode(self, points: Float[Tensor, "object point 6"]) -> Float[Tensor, "object feature"]:
        """Object feature of points [m] and unit normals in frame C; the order of the points does not matter."""
        return self.encoder(points)

    def forward(
        self,
        x_t: Float[Tensor, "batch dimension"],
        t: Int[Tensor, " row"],
        object_feature: Float[Tensor, "row feature"],
        behaviour: Int[Tensor, " row"],
        direction: Float[Tensor, "row 3"],
        has_direction: Bool[Tensor, " row"],
    ) -> Float[Tensor, "batch dimension"]:
        """Prediction for normalised x_t; row = batch, or 1 where all samples share timestep and condition."""
        flag = has_direction[:, None].to(x_t.dtype)
        condition = (
            self.time_embedding(timestep_features(t).to(x_t.dtype))
            + self.object_embedding(object_feature)
            + self.class_embedding(behaviour)
            + self.direction_embedding(torch.cat([direction * flag, flag], dim=-1))
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
        shift_attention: Float[Tensor, "row 1 width"],
        scale_attention: Float[Tensor, "row 1 width"],
        gate_attention: Float[Tensor, "row 1 width"],
        shift_mlp: Float[Tensor, "row 1 width"],
        scale_mlp: Float[Tensor, "row 1 width"],
        gate_mlp: Float[Tensor, "row 1 width"],
    ) -> Float[Tensor, "batch token width"]:
        """Same shape as `tokens`; equal to `tokens` where both gates are zero."""
        attended = self.attend(modulate(tokens, shift_attention, scale_attention))
        tokens = torch.addcmul(tokens, gate_attention, attended)
        return torch.addcmul(tokens, gate_mlp, self.mlp(modulate(tokens, shift_mlp, scale_mlp)))

    def attend(self, tokens: Float[Tensor, "batch token width"]) -> Float[Tensor, "batch token width"]:
        """Multi-head self-attention without mask."""
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
    """LayerNorm without its own parameters, then (1 + scale) x + shift."""
    return torch.addcmul(shift, functional.layer_norm(tokens, tokens.shape[-1:]), 1.0 + scale)


def timestep_features(t: Int[Tensor, " row"]) -> Float[Tensor, "row frequency"]:
    """Sines and cosines of t at geometrically spaced frequencies (Vaswani et al., 2017)."""
    exponents = torch.arange(TIME_FREQUENCIES, dtype=torch.float32, device=t.device) / TIME_FREQUENCIES
    angles = t.float()[:, None] * torch.exp(-math.log(LONGEST_PERIOD) * exponents)
    return torch.cat([angles.cos(), angles.sin()], dim=-1)
