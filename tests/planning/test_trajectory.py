from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError, OutputError
from dexnudge.planning.hand_states import palm_pose, state, state_space
from dexnudge.planning.trajectory import SpeedLimits, Trajectory, timed

NAMES = ("one", "two", "three", "four")


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
    found = timed(space, np.stack([placed(0.0), end]), NAMES, SpeedLimits(), contact_from=1)
    np.testing.assert_allclose(found.duration, seconds)
    slow = timed(space, np.stack([placed(0.0), end]), NAMES, SpeedLimits(contact=0.01), contact_from=0)
    np.testing.assert_allclose(slow.duration, max(seconds, np.linalg.norm(end[:3]) / 0.01))


def test_speeds_stay_within_the_limits(boxy_hand):
    space = state_space(boxy_hand, np.array([0.3, 0.1, -0.5, 0.8]))
    limits = SpeedLimits(base=0.1, base_rotation=0.7, joint=0.9)
    path = np.stack([placed(0.0), placed(0.2, 1.0, 1.0), placed(0.21, -0.5, 0.3), placed(0.5, -0.5, 0.0)])
    found = timed(space, path, NAMES, limits, contact_from=2)
    step = np.diff(found.times)
    poses = np.array([palm_pose(q) for q in found.q])
    turn = (Rotation.from_matrix(poses[:-1, :3, :3]).inv() * Rotation.from_matrix(poses[1:, :3, :3])).magnitude()
    speed = np.linalg.norm(np.diff(found.q[:, :3], axis=0), axis=1) / step
    joint = np.abs(np.diff(found.q[:, 9:], axis=0)).max(axis=1) / step
    assert speed.max() <= 0.1 * (1 + 1e-9)
    assert speed[found.times[:-1] >= found.times[-1] - 0.29 / 0.05 + 1e-6].max() <= 0.05 * (1 + 1e-9)
    assert (turn / step).max() <= 0.7 * (1 + 1e-6)
    assert joint.max() <= 0.9 * (1 + 1e-9)
    fastest = np.max([speed / 0.1, turn / step / 0.7, joint / 0.9], axis=0)
    before = found.times[1:] < found.times[-1] - 0.29 / 0.05 - 1e-6
    assert fastest[before].min() > 0.99  # and none is slower than it has to be


def test_what_is_saved_can_be_read(tmp_path):
    given = Trajectory(np.array([0.0, 0.5]), np.random.default_rng(0).normal(size=(2, 11)), ("a", "b"))
    given.save(tmp_path / "way.npz")
    with np.load(tmp_path / "way.npz", allow_pickle=False) as found:
        np.testing.assert_array_equal(found["times"], given.times)
        np.testing.assert_array_equal(found["q"], given.q)
        assert found["joint_names"].tolist() == ["a", "b"]


@pytest.mark.parametrize(
    ("times", "q", "message"),
    [
        ([0.0, 0.0], np.zeros((2, 10)), "do not increase"),
        ([0.0, 1.0], np.zeros((2, 11)), r"shape \(2, 11\); expected \(2, 10\)"),
        ([0.0, 1.0], np.full((2, 10), np.nan), "NaN"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(times, q, message):
    with pytest.raises(InputError, match=message):
        Trajectory(np.array(times), q, ("a",))


def test_an_unwritable_place_is_named(tmp_path):
    with pytest.raises(OutputError, match="missing"):
        Trajectory(np.zeros(1), np.zeros((1, 9)), ()).save(tmp_path / "missing" / "way.npz")


def test_a_limit_of_zero_is_refused():
    with pytest.raises(InputError, match="base_rotation is 0"):
        replace(SpeedLimits(), base_rotation=0.0)
