"""A built-in phone in its resting frame, and what is generated for it."""

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.hands.hand import Hand
from dexnudge.hands.shadow_lite import shadow_lite
from dexnudge.objects.builtin import builtin_object
from dexnudge.synthesis.object_data import at_rest, generate_object


@pytest.fixture(scope="session")
def hand() -> Hand:
    return shadow_lite()


@pytest.fixture(scope="session")
def phone() -> trimesh.Trimesh:
    return at_rest(builtin_object("phone"))


@pytest.fixture(scope="session")
def generated(hand: Hand):
    """(rows, cloud, counts) of a small run; the phone comes in upside down and elsewhere."""
    mesh = builtin_object("phone")
    mesh.apply_transform(trimesh.transformations.euler_matrix(np.pi, 0.0, 0.3))
    mesh.apply_translation((1.0, -2.0, 0.5))
    torch.set_num_threads(1)
    generator = np.random.default_rng(5)
    return generate_object(hand, mesh, non_prehensile=48, grasps=64, generator=generator, seed=11)
