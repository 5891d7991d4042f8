from itertools import pairwise

import numpy as np
import pytest
import torch

from dexnudge.planning.connect import connect
from dexnudge.planning.hand_clearance import CLEARANCE, HandClearance, MotionCheck
from dexnudge.planning.hand_motion import between, palm_pose, state, state_space
from dexnudge.verification.penetration import PenetrationCheck


@pytest.fixture
def check(boxy_hand, window_scene):
    return MotionCheck(state_space(boxy_hand, np.zeros(4)), HandClearance(boxy_hand, window_scene))


@pytest.fixture(scope="module")
def ends(at):
    """On either side of the wall, half a metre from the hole."""
    return tuple(state(palm_pose(at(x, 0.0, 0.3)), 0.0)[None] for x in (0.8, 0.2))


def dense(path):
    """States at most about a millimetre apart."""
    pieces = [between(a, b, np.linspace(0, 1, 400)) for a, b in pairwise(path)]
    return np.concatenate(pieces)


def test_a_way_through_the_hole_of_a_wall(boxy_hand, window_scene, check, ends):
    assert not check.free(ends[0][0], ends[1][0])
    path = connect(check, *ends, seed=0, budget=20_000)
    np.testing.assert_allclose(path[[0, -1]], np.concatenate(ends), atol=1e-12)
    states = dense(path)
    crossing = states[np.argmin(np.abs(states[:, 0] - 0.5))]
    assert 0.2 < crossing[1] < 0.5
    T = boxy_hand.forward_kinematics(torch.as_tensor(check.space.configurations(states))).numpy()
    found = PenetrationCheck(boxy_hand, window_scene)(T, reach=0.0)
    assert found.environment.max() == 0
    assert found.object.max() == 0
    length = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1).sum()
    shortest = 2 * np.linalg.norm([0.3, 0.24, 0.17])  # over the hole's corner, as far in as the palm's half width
    assert length < 2.0 * shortest


def test_the_same_seed_gives_the_same_path_whatever_was_planned_before(check, ends):
    first = connect(check, *ends, seed=3, budget=20_000)
    other = connect(check, *ends, seed=4, budget=20_000)
    again = connect(check, *ends, seed=3, budget=20_000)
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or not np.allclose(first, other)


def test_a_spent_budget_ends_the_search(check, ends):
    before = check.measure.count
    assert connect(check, *ends, seed=0, budget=40) is None
    assert check.measure.count - before < 200


def test_no_thin_wall_is_jumped_over(boxy_hand, scene_of, at):
    thin = scene_of([[0.5, -1, -1], [0.5005, 1, 1]])
    check = MotionCheck(state_space(boxy_hand, np.zeros(4)), HandClearance(boxy_hand, thin))
    for x in np.linspace(0.8, 1.6, 9):
        start, end = (state(palm_pose(at(place, 0.0, 0.3)), 0.0) for place in (x, 0.1))
        where = check.blocked_at(start, end)
        assert abs((1 - where) * x + where * 0.1 - 0.5) < 0.035 + CLEARANCE + 0.001  # half a palm from the wall
        assert check.free(start, state(palm_pose(at(0.6, 0.0, 0.3)), 0.0))


@pytest.mark.parametrize("slit", [0.0665, 0.0655])
def test_a_slit_is_passed_when_it_leaves_the_clearance_on_both_sides(boxy_hand, scene_of, at, slit):
    scene = scene_of([[0.5, -1, -1], [0.51, -slit / 2, 1]], [[0.5, slit / 2, -1], [0.51, 1, 1]])
    check = MotionCheck(state_space(boxy_hand, np.zeros(4)), HandClearance(boxy_hand, scene))
    ends = (state(palm_pose(at(x, 0.0, 0.3)), 0.0) for x in (0.8, 0.2))
    assert check.free(*ends) == (slit > 0.06 + 2 * CLEARANCE)
