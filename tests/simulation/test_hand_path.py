"""Paths of the hand: where they begin and end, how fast they are, and that rotations turn as they should."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dexnudge.simulation.hand_path import along_line, along_way, bending, palm_velocity, rotations, waiting
from dexnudge.simulation.model import TIMESTEP


def configuration(translation, rotation_vector, angles) -> np.ndarray:
    matrix = Rotation.from_rotvec(rotation_vector).as_matrix()
    return np.concatenate([translation, matrix[:, 0], matrix[:, 1], angles])


START = configuration([0.1, 0.2, 0.3], [0.0, 0.0, 0.4], [0.1, 0.5])
END = configuration([0.2, 0.2, 0.1], [0.0, 0.0, 1.4], [0.3, 0.1])


def test_a_line_ends_where_it_should_and_is_as_fast_as_it_says():
    way = np.array([0.03, 0.0, 0.04])
    path = along_line(START, way, speed=0.1)
    np.testing.assert_allclose(path[-1, :3], START[:3] + way, atol=1e-12)
    np.testing.assert_array_equal(path[:, 3:], np.tile(START[3:], (len(path), 1)))
    speed = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1) / TIMESTEP
    assert speed.max() == pytest.approx(0.1, rel=0.01)
    assert speed[-1] < 0.001
    # (1 - cos(pi t / T)) / 2 over 50 mm has its greatest slope pi / 2 * 50 mm / T.
    assert len(path) * TIMESTEP == pytest.approx(np.pi / 2 * 0.05 / 0.1, abs=2 * TIMESTEP)


def test_a_way_is_linear_but_for_the_rotation_which_turns_evenly():
    path = along_way(np.array([0.0, 1.0]), np.stack([START, END]))
    assert len(path) == round(1.0 / TIMESTEP)
    np.testing.assert_allclose(path[-1], END, atol=1e-9)
    half = path[len(path) // 2 - 1]
    np.testing.assert_allclose(half[[0, 1, 2, 9, 10]], [0.15, 0.2, 0.2, 0.2, 0.3], atol=1e-9)
    np.testing.assert_allclose(rotations(half[None])[0].as_rotvec(), [0.0, 0.0, 0.9], atol=1e-9)
    assert len(along_way(np.zeros(1), START[None])) == 0


def test_velocity_is_told_in_the_axes_of_the_palm():
    path = along_way(np.array([0.0, 1.0]), np.stack([START, END]))
    velocity = palm_velocity(path, START)
    np.testing.assert_allclose(velocity[:, 3:], np.tile([0.0, 0.0, 1.0], (len(path), 1)), atol=1e-9)
    world = rotations(path).apply(velocity[:, :3])
    np.testing.assert_allclose(world, np.tile([0.1, 0.0, -0.2], (len(path), 1)), atol=1e-9)


def test_joints_bend_evenly_and_no_faster_than_told():
    path = bending(START, np.array([0.5, -0.3]), speed=np.full(2, 2.0))
    np.testing.assert_allclose(path[-1, 9:], [0.5, -0.3], atol=1e-12)
    assert len(path) * TIMESTEP == pytest.approx(0.8 / 2.0)  # the second joint turns by 0.8 rad
    np.testing.assert_array_equal(path[:, :9], np.tile(START[:9], (len(path), 1)))
    assert np.abs(np.diff(path[:, 9:], axis=0)).max() / TIMESTEP <= 2.0 + 1e-9


def test_waiting_stays():
    path = waiting(START, seconds=0.1)
    np.testing.assert_array_equal(path, np.tile(START, (50, 1)))
