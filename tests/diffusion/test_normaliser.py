"""Normalising and back, with a proper rotation at the end."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from dexnudge.diffusion.network import MIN_JOINT_STD, MIN_TRANSLATION_STD, Normaliser


def poses(num):
    rng = np.random.default_rng(0)
    matrices = Rotation.random(num, rng=rng).as_matrix()
    parts = [rng.normal(0.02, 0.1, (num, 3)), matrices[:, :, 0], matrices[:, :, 1], rng.uniform(0.0, 1.5, (num, 4))]
    return torch.from_numpy(np.concatenate(parts, axis=1)).float()


def test_round_trip():
    q = poses(100)
    normaliser = Normaliser.fit(q)
    torch.testing.assert_close(normaliser.denormalise(normaliser.normalise(q)), q, atol=1e-6, rtol=1e-5)


def test_unit_scale_and_no_mean_for_rotations():
    q = poses(20_000)
    x = Normaliser.fit(q).normalise(q)
    torch.testing.assert_close(x.std(dim=0), torch.ones(13), atol=0.02, rtol=0.0)
    torch.testing.assert_close(x[:, 3:9], q[:, 3:9] * 3.0**0.5)


def test_every_vector_becomes_a_proper_rotation():
    normaliser = Normaliser.fit(poses(100))
    q = normaliser.denormalise(torch.randn(200, 13, generator=torch.Generator().manual_seed(0))).double()
    first, second = q[:, 3:6], q[:, 6:9]
    matrices = torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)
    torch.testing.assert_close(matrices @ matrices.mT, torch.eye(3).double().expand(200, 3, 3), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(torch.linalg.det(matrices), torch.ones(200).double(), atol=1e-5, rtol=0.0)


def test_entries_that_never_vary_are_not_blown_up():
    normaliser = Normaliser.fit(poses(1).expand(10, 13))
    torch.testing.assert_close(normaliser.std[:3], torch.full((3,), MIN_TRANSLATION_STD))
    torch.testing.assert_close(normaliser.std[9:], torch.full((4,), MIN_JOINT_STD))


def test_a_slide_that_hardly_varies_is_told_apart_in_its_own_measure():
    sliding = np.array([False, True, False, True])
    std = Normaliser.fit(poses(1).expand(10, 13), sliding=sliding).std[9:]
    torch.testing.assert_close(std, MIN_JOINT_STD * torch.tensor([1.0, 0.05, 1.0, 0.05]))
