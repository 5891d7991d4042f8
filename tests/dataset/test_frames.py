"""Turning configurations equals turning the hand's pose as a matrix."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from dexnudge.dataset.loading import turn_clouds, turn_configurations


def test_poses_turn_like_matrices():
    rng = np.random.default_rng(0)
    rotations, yaws = Rotation.random(20, rng=rng), rng.uniform(-7.0, 7.0, 20)
    translations, joints = rng.normal(size=(20, 3)), rng.normal(size=(20, 5))
    matrices = rotations.as_matrix()
    q = np.concatenate([translations, matrices[:, :, 0], matrices[:, :, 1], joints], axis=1)
    turn = Rotation.from_euler("z", yaws[:, None])
    turned = (turn * rotations).as_matrix()
    expected = np.concatenate([turn.apply(translations), turned[:, :, 0], turned[:, :, 1], joints], axis=1)
    found = turn_configurations(torch.from_numpy(q), torch.from_numpy(yaws))
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)


def test_clouds_turn_points_and_normals_alike():
    rng = np.random.default_rng(1)
    clouds, yaws = rng.normal(size=(2, 7, 6)), np.array([0.3, -2.0])
    found = turn_clouds(torch.from_numpy(clouds), torch.from_numpy(yaws)).numpy()
    for cloud, yaw, turned in zip(clouds, yaws, found, strict=True):
        turn = Rotation.from_euler("z", yaw)
        np.testing.assert_allclose(turned, np.concatenate([turn.apply(cloud[:, :3]), turn.apply(cloud[:, 3:])], axis=1))


def test_a_motion_in_direction_k_becomes_plus_x():
    angle = torch.tensor([3 * np.pi / 8])  # direction 3 of 16
    motion = torch.stack([angle.cos(), angle.sin(), torch.zeros(1)], dim=-1)
    q = torch.cat([motion, torch.eye(3)[None, :2].flatten(1), torch.zeros(1, 2)], dim=-1)
    torch.testing.assert_close(turn_configurations(q, -angle)[:, :3], torch.tensor([[1.0, 0.0, 0.0]]))
