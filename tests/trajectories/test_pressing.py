"""Efforts of a push: joint torques that hold the forces on the object, by virtual work."""

import numpy as np
import pytest
import torch

from dexnudge.arms.registry import panda
from dexnudge.arms.robot import Robot
from dexnudge.hands.registry import load_hand
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.simulation.push_forces import PRELOAD, SURPLUS
from dexnudge.trajectories.pressing import palm_jacobians

LEVER = 0.5  # [m] of the pads


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
    lifted = effort[1]
    friction = block_scene.friction_environment * (block_scene.mass * GRAVITY - lifted)  # Coulomb's law
    assert effort[0] == pytest.approx(friction, rel=0.05)
    told = SURPLUS * PRELOAD  # the preload is enough: of half the cones' friction, the block needs 0.74 N on each pad
    assert block_press.link_force == pytest.approx({"pad0": told, "pad1": told}, rel=0.01)
    assert effort[2:] == pytest.approx(told * LEVER, rel=0.05)
    np.testing.assert_allclose(block_press.efforts(gantry, position, np.array([0.5]))[0], effort / 2)
    assert block_press.verdict.success


def test_pads_touch_the_block_and_are_carried_along_with_it(block_press, pad_hand):
    travelled = np.linspace(0.0, 0.05, 7)
    q = block_press.carried(travelled)
    np.testing.assert_allclose(q[0], block_press.touching, atol=1e-9)
    np.testing.assert_allclose(q[:, 0] - q[0, 0], travelled, atol=1e-3)
    np.testing.assert_allclose(q[:, 1:3], q[:1, 1:3].repeat(7, axis=0), atol=1e-3)
    poses = pad_hand.forward_kinematics(torch.as_tensor(q))[3].numpy()
    for link, inward in ((1, 1.0), (2, -1.0)):
        mesh = pad_hand.link_meshes[link].copy()
        mesh.apply_transform(poses[link])
        assert (inward * mesh.vertices[:, 1]).max() == pytest.approx(-0.02, abs=5e-4)
