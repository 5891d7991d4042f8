"""Real hands close: from open to closed the tips come together, on the side to which the palm faces."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from dexnudge.hands.closing import closing
from dexnudge.synthesis.nonprehensile import random_joint_angles

from .catalogue import ONE_OF_EACH

TOUCH = 0.005  # [m] between points 2 mm apart on tips that meet
STEPS = 7
STATED = np.cos(np.radians(20.0))  # between the direction found and the one stated


def tip_distance(hand, angles):
    """Least distance [m] between points of two digits' last links, for each row of joint values."""
    q = torch.zeros(len(angles), 9 + hand.num_joints, dtype=torch.float64)
    q[:, 3] = q[:, 7] = 1.0
    q[:, 9:] = torch.as_tensor(angles)
    transforms, points = hand.forward_kinematics(q).numpy(), hand.dense_points
    least = np.full(len(angles), np.inf)
    for row, placed in enumerate(transforms):
        clouds = [
            points.points[points.link == tip] @ placed[tip, :3, :3].T + placed[tip, :3, 3]
            for tip in hand.fingertip_indices
        ]
        thumb = clouds.pop(hand.thumb)
        least[row] = min(cKDTree(thumb).query(cloud)[0].min() for cloud in clouds)
    return least


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_tips_meet_where_the_palm_faces(name, real_hand):
    hand = real_hand(name)
    found = closing(hand)
    share = np.linspace(0.0, 1.0, STEPS)[:, None]
    distance = tip_distance(hand, (1 - share) * found.open + share * found.closed)
    assert distance[0] > 2 * TOUCH
    assert distance.min() < TOUCH
    assert found.palm_normal @ hand.palm_normal > STATED
    assert found.confidence > 0.5


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_directions_and_draws_of_data_fit_the_hand(name, real_hand):
    hand = real_hand(name)
    assert abs(np.linalg.norm(hand.finger_axis) - 1.0) < 1e-9
    assert abs(hand.finger_axis @ hand.palm_normal) < 1e-9
    for keypoint, tip in zip(hand.fingertip_keypoints, hand.fingertip_indices, strict=True):
        low, high = hand.link_meshes[tip].bounds
        assert ((low - 0.015 < keypoint) & (keypoint < high + 0.015)).all()
    angles = random_joint_angles(hand, 50, np.random.default_rng(0)).numpy()
    assert ((angles >= hand.lower - 1e-6) & (angles <= hand.upper + 1e-6)).all()
    assert (np.ptp(angles, axis=0) > 0.2 * (hand.upper - hand.lower)).all()
