"""Inverse kinematics against forward kinematics, finite differences, and the annulus that a SCARA reaches."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.arms.arm import Arm, JointLimits
from dexnudge.arms.inverse_kinematics import InverseKinematics
from dexnudge.arms.registry import panda
from dexnudge.arms.robot import Robot
from dexnudge.hands.tree import Tree, TreeJoint

BASE = trimesh.transformations.euler_matrix(0.3, -0.2, 1.0)
BASE[:3, 3] = 0.4, -0.1, 0.2


@pytest.fixture(scope="module")
def arm() -> Arm:
    return panda().standing_at(BASE)


@pytest.fixture(scope="module")
def sliding_arm() -> Arm:
    """A turn, a slide and a turn about different axes, with fixed joints before and between them."""
    generator = np.random.default_rng(3)
    joints = []
    for number, (fixed, slides) in enumerate(
        [(True, False), (False, False), (False, True), (True, False), (False, False)]
    ):
        origin = trimesh.transformations.random_rotation_matrix(generator.uniform(size=3))
        origin[:3, 3] = generator.uniform(-0.3, 0.3, 3)
        axis = Rotation.random(rng=generator).apply([0.0, 0.0, 1.0])
        ends = (str(number), str(number + 1))
        joints.append(TreeJoint(f"j{number}", *ends, origin, axis, fixed, -1.0, 1.0, slides=slides))
    ones = np.ones(3)
    limits = JointLimits(-ones, ones, ones, ones, ones, ones)
    tree = Tree("slider", {str(number): trimesh.Trimesh() for number in range(6)}, tuple(joints))
    return Arm("slider", tree, ("j1", "j2", "j4"), limits, np.zeros(3), "5")


def drawn(arm: Arm, count: int, *, inside: float = 1.0) -> np.ndarray:
    limits = arm.limits
    middle, half = (limits.lower + limits.upper) / 2, (limits.upper - limits.lower) / 2
    return middle + inside * half * np.random.default_rng(0).uniform(-1, 1, (count, arm.num_joints))


def flange_poses(arm: Arm, positions: np.ndarray) -> np.ndarray:
    state = InverseKinematics(arm).chain.flange(positions)
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = state.rotation, state.position
    return arm.T_world_base @ poses


@pytest.mark.parametrize("kind", ["panda", "slider", "scara"])
def test_the_flange_is_where_the_whole_robots_kinematics_put_it(kind, arm, sliding_arm, scara, boxy_hand):
    arm = {"panda": arm, "slider": sliding_arm, "scara": scara}[kind]
    robot = Robot(arm, boxy_hand, np.eye(4))
    positions = drawn(arm, 20)
    q = robot.coordinates(np.concatenate([positions, np.zeros((20, 4))], axis=1))
    flange = robot.body.link_names.index(arm.flange)
    expected = robot.body.forward_kinematics(torch.as_tensor(q))[:, flange].numpy()
    np.testing.assert_allclose(flange_poses(arm, positions), expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["panda", "slider", "scara"])
def test_the_jacobian_equals_finite_differences(kind, arm, sliding_arm, scara):
    arm = {"panda": arm, "slider": sliding_arm, "scara": scara}[kind]
    chain, positions, step = InverseKinematics(arm).chain, drawn(arm, 20), 1e-6
    found = chain.flange(positions).jacobian
    for joint in range(arm.num_joints):
        shift = step * np.eye(arm.num_joints)[joint]
        after, before = chain.flange(positions + shift), chain.flange(positions - shift)
        turn = Rotation.from_matrix(after.rotation @ before.rotation.swapaxes(1, 2)).as_rotvec()
        slope = np.concatenate([after.position - before.position, turn], axis=1) / (2 * step)
        np.testing.assert_allclose(found[:, :, joint], slope, atol=1e-8)


def test_poses_that_a_panda_reaches_are_found_within_its_limits(arm):
    poses, kinematics = flange_poses(arm, drawn(arm, 100)), InverseKinematics(arm)
    starts = kinematics.starts(8)
    found = kinematics.solve_all(np.repeat(poses, 8, axis=0), np.tile(starts, (100, 1)))
    solved = found.solved.reshape(100, 8)
    assert solved.any(axis=1).mean() >= 0.98
    positions = found.positions[found.solved]
    assert (positions >= arm.limits.lower).all()
    assert (positions <= arm.limits.upper).all()
    np.testing.assert_allclose(flange_poses(arm, positions), np.repeat(poses, 8, axis=0)[found.solved], atol=3e-4)


def test_a_pose_is_solved_alone_as_among_others(arm):
    poses, kinematics = flange_poses(arm, drawn(arm, 6)), InverseKinematics(arm)
    together = kinematics.solve_all(poses, np.tile(arm.home, (6, 1)))
    for row, pose in enumerate(poses):
        alone = kinematics.solve(pose, arm.home)
        assert (alone is not None) == together.solved[row]
        if alone is not None:
            np.testing.assert_allclose(alone, together.positions[row], atol=1e-9)


def test_the_solution_near_the_start_is_kept(arm):
    positions = drawn(arm, 100, inside=0.8)
    poses, kinematics = flange_poses(arm, positions), InverseKinematics(arm)
    poses[:, :3, 3] += (0.002, 0.0, 0.0)
    found = kinematics.solve_all(poses, positions, most_steps=8)
    assert found.solved.mean() > 0.95
    assert np.quantile(np.abs(found.positions - positions)[found.solved].max(axis=1), 0.95) < 0.05


def test_starts_are_home_and_the_same_every_time(arm):
    starts = InverseKinematics(arm).starts(8)
    np.testing.assert_array_equal(starts[0], arm.home)
    np.testing.assert_array_equal(starts, InverseKinematics(arm).starts(8))


@pytest.mark.parametrize("stand", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.5)])
def test_a_scara_reaches_its_annulus_and_nothing_else(scara, stand):
    """Wrist at distance r from the base: two links of 0.4 and 0.3 m reach it iff 0.1 <= r <= 0.7."""
    base = trimesh.transformations.translation_matrix(stand)
    arm = scara.standing_at(base)
    generator = np.random.default_rng(1)
    radius, around, facing = generator.uniform((0.02, -3.0, -1.2), (0.9, 3.0, 1.2), (200, 3)).T
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec((around + facing)[:, None] * (0, 0, 1)).as_matrix()
    wrist = radius[:, None] * np.stack([np.cos(around), np.sin(around), np.zeros(200)], axis=1)
    poses[:, :3, 3] = wrist + 0.1 * poses[:, :3, 0]
    kinematics = InverseKinematics(arm)
    found = kinematics.solve_all(np.repeat(base @ poses, 12, axis=0), np.tile(kinematics.starts(12), (200, 1)))
    reached = found.solved.reshape(200, 12).any(axis=1)
    clear = np.minimum(abs(radius - 0.1), abs(radius - 0.7)) > 0.01
    inside = (radius > 0.1) & (radius < 0.7)
    assert not reached[clear & ~inside].any()
    assert (
        reached[clear & inside].mean() > 0.97
    )  # joints that turn by 3.1 rad either way leave out a wedge of 5 degrees
    lifted = base @ poses[inside]
    lifted[:, 2, 3] += 0.51
    assert not kinematics.solve_all(lifted, np.tile(arm.home, (len(lifted), 1))).solved.any()


def test_a_joint_at_its_limit_stays_there_while_others_go_on(scara):
    limits = replace(scara.limits, upper=np.array([0.5, 0.2, 3.1, 3.1]))
    arm = replace(scara, limits=limits, home=np.array([0.0, 0.2, 0.5, 0.5]))
    pose = flange_poses(arm, np.array([[0.1, 0.2, 1.2, -0.4]]))[0]
    found = InverseKinematics(arm).solve(pose, arm.home)
    assert found is not None
    np.testing.assert_allclose(flange_poses(arm, found[None])[0], pose, atol=3e-4)
