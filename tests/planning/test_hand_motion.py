import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from dexnudge.planning.hand_motion import (
    BASE_SPEED,
    CONTACT_SPEED,
    JOINT_SPEED,
    TURN_SPEED,
    between,
    matrices,
    palm_pose,
    rotation_angle,
    state,
    state_space,
    timed,
)


def placed(x, turn=0.0, opening=0.0):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0, 0, turn]).as_matrix()
    pose[0, 3] = x
    return state(pose, opening)


@pytest.mark.parametrize(
    ("end", "seconds"),
    [
        (placed(0.5), 0.5 / 0.25),
        (placed(0.01, turn=1.2), 1.2 / 1.5),
        (placed(0.01, opening=1.0), 0.8 / 2.0),  # the joint that turns farthest
    ],
)
def test_the_slowest_limit_alone_sets_the_duration(boxy_hand, end, seconds):
    space = state_space(boxy_hand, np.array([0.3, 0.1, -0.5, 0.8]))
    found = timed(space, np.stack([placed(0.0), end]), contact_from=1)
    np.testing.assert_allclose(found.duration, seconds)
    slow = timed(space, np.stack([placed(0.0), end]), contact_from=0)
    np.testing.assert_allclose(slow.duration, max(seconds, np.linalg.norm(end[:3]) / CONTACT_SPEED))


def test_speeds_stay_within_the_limits(boxy_hand):
    space = state_space(boxy_hand, np.array([0.3, 0.1, -0.5, 0.8]))
    path = np.stack([placed(0.0), placed(0.2, 1.0, 1.0), placed(0.21, -0.5, 0.3), placed(0.5, -0.5, 0.0)])
    found = timed(space, path, contact_from=2)
    step = np.diff(found.times)
    poses = np.array([palm_pose(q) for q in found.q])
    turn = (Rotation.from_matrix(poses[:-1, :3, :3]).inv() * Rotation.from_matrix(poses[1:, :3, :3])).magnitude()
    speed = np.linalg.norm(np.diff(found.q[:, :3], axis=0), axis=1) / step
    joint = np.abs(np.diff(found.q[:, 9:], axis=0)).max(axis=1) / step
    assert speed.max() <= BASE_SPEED * (1 + 1e-9)
    assert speed[found.times[:-1] >= found.times[-1] - 0.29 / CONTACT_SPEED + 1e-6].max() <= CONTACT_SPEED * (1 + 1e-9)
    assert (turn / step).max() <= TURN_SPEED * (1 + 1e-6)
    assert joint.max() <= JOINT_SPEED * (1 + 1e-9)
    fastest = np.max([speed / BASE_SPEED, turn / step / TURN_SPEED, joint / JOINT_SPEED], axis=0)
    before = found.times[1:] < found.times[-1] - 0.29 / CONTACT_SPEED - 1e-6
    assert fastest[before].min() > 0.99  # and none is slower than it has to be


CLOSED = np.array([0.3, 0.1, -0.5, 0.8])


def poses():
    first, second = np.eye(4), np.eye(4)
    first[:3, :3], second[:3, :3] = Rotation.random(2, random_state=3).as_matrix()
    first[:3, 3], second[:3, 3] = (0.1, -0.2, 0.3), (0.4, 0.1, 0.0)
    return first, second


def test_motion_between_two_states_is_slerp_the_short_way():
    first, second = poses()
    start, end = state(first, 0.2), state(second, 1.0)
    fraction = np.linspace(0, 1, 7)
    expected = Slerp([0, 1], Rotation.from_matrix([first[:3, :3], second[:3, :3]]))(fraction).as_matrix()
    for signed in (end, np.concatenate([end[:3], -end[3:7], end[7:]])):  # q and -q are one rotation
        found = between(start, signed, fraction)
        np.testing.assert_allclose(matrices(found), expected, atol=1e-12)
        np.testing.assert_allclose(found[:, :3], first[:3, 3] + fraction[:, None] * (second[:3, 3] - first[:3, 3]))
        np.testing.assert_allclose(found[:, 7], 0.2 + 0.8 * fraction)
        angle = (Rotation.from_matrix(first[:3, :3]).inv() * Rotation.from_matrix(second[:3, :3])).magnitude()
        np.testing.assert_allclose(rotation_angle(start, signed), angle)


def test_no_point_of_the_hand_moves_farther_than_the_bound(boxy_hand):
    space = state_space(boxy_hand, CLOSED)
    first, second = poses()
    start, end = state(first, 0.0), state(second, 1.0)
    q = space.configurations(between(start, end, np.linspace(0, 1, 60)))
    T = boxy_hand.forward_kinematics(torch.as_tensor(q)).numpy()
    dense = boxy_hand.dense_points
    placed = np.einsum("nij,kj->nki", T[:, 4, :3, :3], dense.points[dense.link == 4]) + T[:, 4, None, :3, 3]
    way = np.linalg.norm(np.diff(placed, axis=0), axis=2).sum(axis=0).max()
    assert way <= space.displacement(start, end) <= 2.5 * way


def test_configurations_are_the_palm_poses_and_joint_angles(boxy_hand):
    space = state_space(boxy_hand, CLOSED)
    pose = poses()[0]
    q = space.configurations(state(pose, 0.0)[None])[0]
    np.testing.assert_allclose(palm_pose(q), pose, atol=1e-12)
    np.testing.assert_allclose(q[9:], CLOSED)
    np.testing.assert_allclose(space.joint_angles(np.ones(1))[0], np.zeros(4), atol=1e-12)
