"""Efforts of a push: joint torques that hold the forces on the object, by virtual work."""

import numpy as np
import pytest
import torch

from dexnudge.arms.named.panda import panda
from dexnudge.arms.robot import Robot
from dexnudge.hands.registry import load_hand
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.trajectories.pressing import palm_jacobians


def test_palm_jacobians_are_those_of_finite_differences(gripper):
    mount = np.eye(4)
    mount[:3, 3] = (0.02, -0.01, 0.1)
    robot = Robot(panda(), load_hand(gripper), mount)
    rng = np.random.default_rng(0)
    positions = rng.uniform(robot.limits.lower, robot.limits.upper, size=(3, len(robot.joint_names)))
    local = np.array([0.03, 0.02, 0.11])
    poses = robot.palm_poses(positions)
    found = palm_jacobians(robot, positions, poses[:, :3, :3] @ local + poses[:, :3, 3])
    step = 1e-6
    for joint in range(robot.arm.num_joints):
        ahead, behind = (
            robot.palm_poses(positions + sign * step * np.eye(positions.shape[1])[joint]) for sign in (1, -1)
        )
        linear = ((ahead - behind)[:, :3, :3] @ local + (ahead - behind)[:, :3, 3]) / (2 * step)
        spin = ((ahead - behind)[:, :3, :3] / (2 * step)) @ poses[:, :3, :3].transpose(0, 2, 1)
        angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        np.testing.assert_allclose(found[:, :3, joint], linear, atol=1e-6)
        np.testing.assert_allclose(found[:, 3:, joint], angular, atol=1e-6)


def test_a_gantry_pulls_with_what_the_block_slides_by_and_the_pads_press_as_told(gantry, block_press, block_scene):
    position = np.array([[0.02, 0.0, *block_press.touching[9:]]])
    (effort,) = block_press.efforts(gantry, position, np.array([1.0]))
    friction = block_scene.friction_environment * block_scene.mass * GRAVITY
    surplus = block_press.forces.surplus[0]
    total = block_press.forces.force[0].sum(axis=0)
    assert effort[0] == pytest.approx(total[0], rel=1e-6)  # sliding along x carries the force along x
    assert effort[1] == pytest.approx(total[2], rel=1e-6)
    # What the hand presses down, the table's friction takes: Coulomb's law for weight and press together.
    assert total[0] == pytest.approx(surplus * friction - block_scene.friction_environment * total[2], rel=0.05)
    motors = np.flatnonzero(block_press.forces.motor_torque[0])
    assert effort[2:] == pytest.approx(block_press.forces.motor_torque[0, motors])
    assert not block_press.efforts(gantry, position, np.zeros(1)).any()


def test_touching_pads_touch_and_are_carried_along(block_press, pad_hand):
    q = block_press.carried(np.array([0.0, 0.03]))
    np.testing.assert_allclose(q[1] - q[0], [0.03, *np.zeros(10)], atol=1e-12)
    poses = pad_hand.forward_kinematics(torch.as_tensor(q[:1]))[0].numpy()
    for link, inward in ((1, 1.0), (2, -1.0)):
        mesh = pad_hand.link_meshes[link].copy()
        mesh.apply_transform(poses[link])
        inner = (inward * mesh.vertices[:, 1]).max()
        assert inner == pytest.approx(-0.02, abs=3e-4)
    assert set(block_press.link_force) == {"pad0", "pad1"}
