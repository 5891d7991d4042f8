"""A phone on a table made ready for sampling, and a small untrained prior for the Shadow Lite."""

import numpy as np
import pytest
import torch

from dexnudge.dataset.manifest import joint_groups
from dexnudge.diffusion.config import Architecture, ModelConfig
from dexnudge.diffusion.network import ConditionalDenoiser, Normaliser
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.hands.hand import Hand
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.random_start import random_start
from dexnudge.scenes.families import SCENE_FAMILIES
from dexnudge.scenes.scene import Scene

SMALL = Architecture(width=32, depth=2, num_heads=2, mlp_ratio=2, encoder_widths=(16, 32), feature_width=32)


@pytest.fixture(scope="session")
def hand(shadow_hand: Hand) -> Hand:
    return shadow_hand


@pytest.fixture(scope="session")
def scene() -> Scene:
    return SCENE_FAMILIES["table"](builtin_object("phone"), np.random.default_rng(0))


@pytest.fixture(scope="session")
def problem(scene: Scene) -> SamplingProblem:
    return prepare(scene)


@pytest.fixture(scope="session")
def starts(hand: Hand, problem: SamplingProblem) -> torch.Tensor:
    """Random hands around the phone, (24, 25), frame C."""
    return random_start(hand, problem.cloud, count=24, generator=torch.Generator().manual_seed(0))


@pytest.fixture(scope="session")
def prior(hand: Hand, problem: SamplingProblem) -> DiffusionPrior:
    """Its zero layers are filled, as training would, so that its estimate depends on its input."""
    digits = tuple(joint_groups(hand).values())
    config = ModelConfig(hand=hand.name, joint_names=hand.joint_names, joint_groups=digits, architecture=SMALL)
    generator = torch.Generator().manual_seed(1)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = ConditionalDenoiser(config)
    with torch.no_grad():
        for layer in (network.modulation, *network.token_out):
            layer.weight.normal_(std=0.1, generator=generator)
    hands = random_start(hand, problem.cloud, count=300, generator=generator)
    return DiffusionPrior(network.eval().requires_grad_(False), Normaliser.fit(hands))
