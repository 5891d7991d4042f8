"""Where non-prehensile starts aim and from where they come, on a disc, whose side faces every direction."""

import numpy as np
import pytest
import trimesh
from scipy.stats import binom

from dexnudge.energies.descent import configuration_from_pose
from dexnudge.geometry.surface_points import SurfacePoints, surface_points
from dexnudge.synthesis.nonprehensile import (
    ABOVE_SUPPORT,
    DIGIT_COUNTS,
    INTENTS,
    INTERLOCKED,
    SIDE_NORMAL,
    STANDOFF,
    TOP_NORMAL,
    PreContact,
    random_joint_angles,
    sample_pre_contact,
)
from dexnudge.verification.penetration import self_penetration

COUNT = 1500
CHANCE = 1e-7  # of a share outside its bounds though nothing is wrong


@pytest.fixture(scope="module")
def surface() -> SurfacePoints:
    """A disc of 12 cm about the origin."""
    return surface_points(trimesh.creation.cylinder(radius=0.06, height=0.03, sections=64), spacing=0.004)


@pytest.fixture(scope="module")
def starts(hand, surface) -> PreContact:
    return sample_pre_contact(hand, surface, np.zeros(3), count=COUNT, generator=np.random.default_rng(0))


@pytest.fixture(scope="module")
def outward(surface, starts) -> np.ndarray:
    """Mean outward normal at each start's targets."""
    found = np.zeros((COUNT, 3))
    for item in range(COUNT):
        for place in starts.target[item, starts.touches[item]]:
            apart = np.linalg.norm(surface.points - place, axis=1)
            assert apart.min() < 1e-12  # a target is a point of the surface
            found[item] += surface.normals[apart.argmin()]
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def intended(starts: PreContact, intent: str) -> np.ndarray:
    return np.asarray(starts.intents) == intent


def assert_share(found: int, share: float, total: int) -> None:
    low, high = binom.interval(1 - CHANCE, total, share)
    assert low <= found <= high


@pytest.mark.parametrize("intent", list(INTENTS))
def test_shares_of_the_intents(starts, intent):
    assert_share(int(intended(starts, intent).sum()), INTENTS[intent], COUNT)


@pytest.mark.parametrize("digits", list(DIGIT_COUNTS))
def test_shares_of_the_numbers_of_digits(starts, digits):
    assert_share(int((starts.touches.sum(axis=1) == digits).sum()), DIGIT_COUNTS[digits], COUNT)


def test_presses_aim_at_the_top_and_the_others_at_the_side(surface, starts, outward):
    press = intended(starts, "press")
    assert (outward[press, 2] > TOP_NORMAL).all()
    top = starts.target[press][starts.touches[press]][:, 2]
    np.testing.assert_allclose(top, surface.points[:, 2].max(), atol=1e-9)
    # All targets of one start face against the same motion, each within the angle that SIDE_NORMAL allows.
    for item in np.flatnonzero(~press):
        places = starts.target[item, starts.touches[item]]
        angles = np.arctan2(places[:, 1], places[:, 0]) - np.arctan2(outward[item, 1], outward[item, 0])
        assert np.abs((angles + np.pi) % (2 * np.pi) - np.pi).max() < 2 * np.arccos(SIDE_NORMAL)
        np.testing.assert_allclose(np.linalg.norm(places[:, :2], axis=1), 0.06, atol=1e-3)


def test_hooking_hands_come_from_ahead_and_pushing_ones_from_anywhere(hand, starts, outward):
    # The targets lie on the trailing side: outward points against the motion. Fingers that reach over the object from
    # ahead point the same way; their heading strays by 40 degrees, the side's normal by up to 37.
    fingers = starts.pose.rotation.double().numpy() @ hand.finger_axis
    back = np.einsum("ni,ni->n", fingers[:, :2], outward[:, :2]) > 0
    hook, push = intended(starts, "hook"), intended(starts, "push")
    assert back[hook].mean() > 0.9
    assert_share(int(back[push].sum()), 0.5, int(push.sum()))
    root = starts.pose.translation.double().numpy()
    ahead = np.einsum("ni,ni->n", root[:, :2], outward[:, :2]) < 0
    assert ahead[hook].mean() > ahead[push].mean() + 0.2


def test_tips_stand_off_from_the_middle_of_their_targets_and_hands_rise_out_of_the_support(
    hand, surface, starts, outward
):
    q = configuration_from_pose(starts.pose).double()
    tips = hand.keypoints(q).numpy()
    points, transforms = hand.sparse_points, hand.forward_kinematics(q).numpy()
    raised = 0
    for item in range(0, COUNT, 5):
        touch = starts.touches[item]
        offset = tips[item, touch].mean(axis=0) - starts.target[item, touch].mean(axis=0)
        lowest = min(
            trimesh.transform_points(points.points[points.link == link], transforms[item, link])[:, 2].min()
            for link in np.unique(points.link)
        ) - float(surface.points[:, 2].min())
        assert lowest >= ABOVE_SUPPORT - 1e-5
        if starts.intents[item] == "press":  # the normal points up, as a raised hand goes
            distance, rise = offset[2], max(0.0, offset[2] - STANDOFF[1])
        else:
            distance = offset[:2] @ outward[item, :2]
            rise = offset[2]
            assert distance <= STANDOFF[1] + 1e-5
        assert distance >= STANDOFF[0] - 1e-5
        np.testing.assert_allclose(
            offset - (0.0, 0.0, rise), (distance - rise * outward[item, 2]) * outward[item], atol=1e-5
        )
        if rise > 1e-5:
            assert abs(lowest - ABOVE_SUPPORT) < 1e-5
            raised += 1
    assert 0.2 < raised / len(range(0, COUNT, 5)) < 0.9


def test_links_of_a_start_are_not_deep_in_each_other(hand, starts):
    deep = self_penetration(hand, starts.pose.joint_angles.numpy().astype(np.float64)) > INTERLOCKED
    drawn = random_joint_angles(hand, 300, np.random.default_rng(1)).numpy().astype(np.float64)
    assert deep.mean() < 0.01 < (self_penetration(hand, drawn) > INTERLOCKED).mean()


def test_rotations_are_proper_and_joints_within_limits(hand, starts):
    rotation = starts.pose.rotation.double().numpy()
    np.testing.assert_allclose(rotation @ rotation.transpose(0, 2, 1), np.tile(np.eye(3), (COUNT, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-5)
    angles = random_joint_angles(hand, 200, np.random.default_rng(1)).numpy()
    for found in (angles, starts.pose.joint_angles.numpy()):
        assert (found >= hand.lower - 1e-6).all()
        assert (found <= hand.upper + 1e-6).all()
        follower, leader = hand.coupled_indices.T
        assert (found[:, follower] <= found[:, leader] + 1e-6).all()


def test_a_surface_without_a_top_or_side_still_gives_starts(hand):
    ball = surface_points(trimesh.creation.icosphere(subdivisions=1, radius=0.03), spacing=0.02)
    below = SurfacePoints(ball.points, np.tile([0.0, 0.0, -1.0], (len(ball.points), 1)))
    found = sample_pre_contact(hand, below, np.zeros(3), count=20, generator=np.random.default_rng(2))
    assert found.pose.translation.isfinite().all()
    assert found.touches.any(axis=1).all()


def test_the_same_generator_gives_the_same_starts(hand, surface):
    one, again, other = (
        sample_pre_contact(hand, surface, np.zeros(3), count=10, generator=np.random.default_rng(seed))
        for seed in (3, 3, 4)
    )
    assert one.intents == again.intents
    np.testing.assert_array_equal(one.target, again.target)
    np.testing.assert_array_equal(one.pose.translation.numpy(), again.pose.translation.numpy())
    assert not np.array_equal(one.pose.translation.numpy(), other.pose.translation.numpy())
