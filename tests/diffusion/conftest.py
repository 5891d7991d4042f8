"""A small network for a hand with the Shadow Lite's joints, and the made-up dataset of `tests/dataset/toy.py`."""

from types import ModuleType

import pytest
import torch

from dexnudge.diffusion.config import Architecture, ModelConfig
from dexnudge.diffusion.network import ConditionalDenoiser, Normaliser

SMALL = Architecture(width=32, depth=2, num_heads=2, mlp_ratio=2, encoder_widths=(16, 32), feature_width=32)


@pytest.fixture(scope="session")
def architecture() -> Architecture:
    return SMALL


@pytest.fixture(scope="session")
def config(toy: ModuleType) -> ModelConfig:
    return ModelConfig(
        hand="toy", joint_names=toy.JOINT_NAMES, joint_groups=tuple(toy.DIGIT_JOINTS.values()), architecture=SMALL
    )


@pytest.fixture
def untrained(config: ModelConfig) -> ConditionalDenoiser:
    """A network as training starts with it."""
    torch.manual_seed(0)
    return ConditionalDenoiser(config)


@pytest.fixture
def network(untrained: ConditionalDenoiser) -> ConditionalDenoiser:
    """A network whose zero layers have been filled, as training would, so that every input matters."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for layer in (untrained.modulation, *untrained.token_out):
            layer.weight.normal_(std=0.1, generator=generator)
    return untrained


@pytest.fixture
def normaliser(config: ModelConfig) -> Normaliser:
    rows = torch.rand(200, config.dimension, generator=torch.Generator().manual_seed(2))
    return Normaliser.fit(rows * torch.linspace(0.1, 2.0, config.dimension))


@pytest.fixture
def points() -> torch.Tensor:
    """Surface points and unit normals of one ellipsoid, (1, 300, 6)."""
    unit = torch.nn.functional.normalize(torch.randn(300, 3, generator=torch.Generator().manual_seed(3)), dim=1)
    axes = torch.tensor([0.08, 0.04, 0.005])
    return torch.cat([unit * axes, torch.nn.functional.normalize(unit / axes, dim=1)], dim=1)[None]
