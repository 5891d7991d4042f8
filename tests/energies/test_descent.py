"""Every step of the descent is a legal hand, and it gets where it is sent."""

import numpy as np
import pytest
import torch
import trimesh
from moves import retract, rotation_vector_to_matrix

from dexnudge.energies.descent import (
    HandDescent,
    HandPose,
    StepSizes,
    configuration_from_pose,
    pose_from_configuration,
)
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.energies.terms import TermWeights

BATCH = 5
ROUNDING = 1e-6


@pytest.fixture(scope="module")
def hand(shadow_hand):
    return shadow_hand


def random_pose(hand, seed: int = 0) -> HandPose:
    generator = torch.Generator().manual_seed(seed)
    rotation = rotation_vector_to_matrix(torch.randn(BATCH, 3, generator=generator))
    q = torch.zeros(BATCH, 9 + hand.num_joints)
    lower, upper = (torch.as_tensor(limit, dtype=torch.float32) for limit in (hand.lower, hand.upper))
    q[:, 9:] = lower + (upper - lower) * torch.rand(BATCH, hand.num_joints, generator=generator)
    return HandPose(0.1 * torch.randn(BATCH, 3, generator=generator), rotation, hand.clamp(q)[:, 9:])


def test_limits_couplings_and_rotations_hold_after_every_step(hand):
    pose, descent = random_pose(hand), HandDescent(hand, BATCH)
    lower, upper = (torch.as_tensor(limit, dtype=torch.float32) for limit in (hand.lower, hand.upper))
    follower, leader = hand.coupled_indices.T
    generator = torch.Generator().manual_seed(1)
    push = torch.randn(BATCH, 6 + hand.num_joints, generator=generator)
    for _ in range(100):
        pose = descent.step(pose, push + 0.2 * torch.randn(push.shape, generator=generator))
        assert (pose.joint_angles >= lower - ROUNDING).all()
        assert (pose.joint_angles <= upper + ROUNDING).all()
        assert (pose.joint_angles[:, follower] <= pose.joint_angles[:, leader]).all()
        gram = pose.rotation.transpose(1, 2) @ pose.rotation
        torch.testing.assert_close(gram, torch.eye(3).expand(BATCH, 3, 3), atol=1e-4, rtol=0.0)
    at_limit = torch.isclose(pose.joint_angles, lower) | torch.isclose(pose.joint_angles, upper)
    assert at_limit.float().mean() > 0.5, "a steady push must have brought most joints to a limit"


def test_scale_zero_holds_a_hand_still(hand):
    pose, descent = random_pose(hand), HandDescent(hand, BATCH)
    gradient = torch.randn(BATCH, 6 + hand.num_joints, generator=torch.Generator().manual_seed(2))
    scale = torch.tensor([1.0, 0.0, 1.0, 0.0, 1.0])[:, None]
    moved = descent.step(pose, gradient, scale=scale)
    for name in ("translation", "rotation", "joint_angles"):
        same = (getattr(moved, name) == getattr(pose, name)).flatten(1).all(dim=1)
        assert same.tolist() == [False, True, False, True, False], name


def test_no_step_is_longer_than_its_size_says(hand):
    sizes = StepSizes(translation=0.001, rotation=0.01, joints=0.02)
    pose, descent = random_pose(hand), HandDescent(hand, BATCH, steps=sizes)
    gradient = torch.zeros(BATCH, 6 + hand.num_joints)
    gradient[:, 0] = torch.logspace(-3, 3, BATCH)
    moved = descent.step(pose, gradient)
    # The second moment is a mean over three coordinates, so one that moves alone moves sqrt(3) times as far.
    length = (moved.translation - pose.translation).norm(dim=1)
    torch.testing.assert_close(length, torch.full((BATCH,), 3**0.5 * 0.001), atol=1e-5, rtol=1e-3)
    assert torch.equal(moved.rotation, pose.rotation)
    torch.testing.assert_close(moved.joint_angles, pose.joint_angles)


def test_samples_do_not_feel_their_neighbours(hand):
    pose = random_pose(hand)
    gradient = torch.randn(BATCH, 6 + hand.num_joints, generator=torch.Generator().manual_seed(3))
    together = HandDescent(hand, BATCH).step(pose, gradient)
    row = HandPose(pose.translation[1:2], pose.rotation[1:2], pose.joint_angles[1:2])
    alone = HandDescent(hand, 1).step(row, gradient[1:2])
    torch.testing.assert_close(configuration_from_pose(together)[1:2], configuration_from_pose(alone))


def test_steps_equal_adam_written_out(hand):
    """Moments per kind, bias corrected, as in Kingma and Ba (2015); the moves by `retract`."""
    sizes, decay, joints = StepSizes(), (0.7, 0.9), hand.num_joints
    size = torch.tensor([sizes.translation] * 3 + [sizes.rotation] * 3 + [sizes.joints] * joints)
    pose = expected = random_pose(hand)
    descent = HandDescent(hand, BATCH, decay=decay, tied=True)
    generator = torch.Generator().manual_seed(6)
    first, second = torch.zeros(BATCH, 6 + joints), torch.zeros(BATCH, 6 + joints)
    for count in range(1, 6):
        gradient = torch.randn(BATCH, 6 + joints, generator=generator)
        kinds = [
            part.square().mean(dim=1, keepdim=True).expand_as(part) for part in gradient.split((3, 3, joints), dim=1)
        ]
        first = decay[0] * first + (1 - decay[0]) * gradient
        second = decay[1] * second + (1 - decay[1]) * torch.cat(kinds, dim=1)
        move = -0.5 * size * (first / (1 - decay[0] ** count)) / (second / (1 - decay[1] ** count)).sqrt()
        expected = retract(hand, expected, move, tied=True)
        pose = descent.step(pose, gradient, scale=0.5)
    torch.testing.assert_close(configuration_from_pose(pose), configuration_from_pose(expected), atol=1e-5, rtol=0.0)


def test_it_reaches_targets_that_a_hand_can_reach(hand):
    wanted = random_pose(hand, seed=4)
    away = torch.randn(BATCH, 6 + hand.num_joints, generator=torch.Generator().manual_seed(5))
    away *= torch.tensor([0.03] * 3 + [0.3] * 3 + [0.2] * hand.num_joints)
    pose = retract(hand, wanted, away)
    far = trimesh.creation.box((0.02, 0.02, 0.02))
    far.apply_translation((5.0, 0.0, 0.0))
    only_targets = TermWeights(environment=0.0, object=0.0, self=0.0, contact=0.0, target=1.0)
    energy = HandEnergy(hand, build_scene_fields(far, None), BATCH, only_targets)
    tips = hand.fingertip_indices
    energy.target[:, tips] = hand.keypoints(configuration_from_pose(wanted))
    energy.target_weight[:, tips] = 1.0
    descent = HandDescent(hand, BATCH, steps=StepSizes(translation=0.005, rotation=0.05, joints=0.05))
    before = energy(pose).clone()
    for step in range(200):
        energy(pose)
        pose = descent.step(pose, energy.gradient, scale=0.01 ** (step / 200))
    gap = (hand.keypoints(configuration_from_pose(pose)) - energy.target[:, tips]).norm(dim=2)
    assert (energy(pose) < 0.01 * before).all()
    assert float(gap.median()) < 0.002


def test_a_configuration_survives_the_way_there_and_back(hand):
    q = configuration_from_pose(random_pose(hand))
    torch.testing.assert_close(configuration_from_pose(pose_from_configuration(q)), q)


def test_a_rotation_vector_turns_the_hand_about_the_working_frames_axes(hand):
    pose, move = random_pose(hand), torch.zeros(BATCH, 6 + hand.num_joints)
    move[:, 5] = np.pi / 2
    turned = retract(hand, pose, move).rotation
    about_z = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    torch.testing.assert_close(turned, about_z @ pose.rotation, atol=1e-6, rtol=1e-5)
