"""Where a hand goes that has let go: nowhere if it can open, else the shortest free way."""

import numpy as np
import pytest
import trimesh

from dexnudge.execution.scene_rollout import DISTANCES, opening_path, retreat
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.verification.penetration import self_penetration

BENT = 1.5  # [rad]


def scene_of(*bodies: trimesh.Trimesh) -> Scene:
    pose = np.eye(4)
    pose[:3, 3] = 2.0, 2.0, 0.01
    floor = box((1.9, 1.9, -0.04), (2.1, 2.1, 0.0))
    return Scene(
        trimesh.creation.box((0.1, 0.06, 0.02)),
        trimesh.util.concatenate([floor, *bodies]),
        pose,
        np.array([1.0, 0.0, 0.0]),
    )


def bent_hand() -> np.ndarray:
    """Palm at the origin, its finger bent toward +y; the open finger would reach up to z = 62 mm."""
    return np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, BENT])


def test_a_hand_in_free_space_stays(small_hand):
    way, openings = retreat(small_hand, scene_of(), bent_hand())
    np.testing.assert_array_equal(way, np.zeros(3))
    np.testing.assert_array_equal(openings, [[0.0]])


def test_a_hand_under_a_shelf_draws_back_until_its_finger_can_open(small_hand):
    q = bent_hand()
    shelf = box((-0.2, -0.2, 0.04), (0.2, 0.2, 0.06))  # 40 mm up: over the bent finger, in the way of the open one
    scene = scene_of(shelf)
    way, _ = retreat(small_hand, scene, q)
    assert np.linalg.norm(way) == pytest.approx(DISTANCES[1])  # 22 mm too high for the open finger
    measure = HandClearance(small_hand, scene)
    for angle in np.linspace(0.0, BENT, 7):
        found = measure((q[:3] + way)[None], np.eye(3)[None], np.array([[angle]]))
        assert found.distance.min() >= 0.003


def test_a_hand_in_a_closed_box_has_no_way(small_hand):
    low, high = np.array([-0.038, -0.038, -0.038]), np.array([0.038, 0.068, 0.038])  # the finger is 50 mm long
    walls = []
    for axis in range(3):
        for side, face in ((-1, low), (1, high)):
            corners = np.array([low - 0.01, high + 0.01])
            corners[:, axis] = np.sort([face[axis], face[axis] + 0.01 * side])
            walls.append(box(*corners.tolist()))
    assert retreat(small_hand, scene_of(*walls), bent_hand()) is None


def test_fingers_that_would_cross_open_one_after_the_other(shadow_hand):
    hand = shadow_hand
    angles = np.array([0.10, 0.23, 0.05, 0.05, 0.22, 1.41, 1.05, 1.05, 0.03, 1.45, 0.64, 0.64, 0.75, 0.04, 0.32, 0.06])
    opened = np.clip(0.0, hand.lower, hand.upper)
    assert self_penetration(hand, angles + np.linspace(0.0, 1.0, 40)[:, None] * (opened - angles)).max() > 0.001
    path = opening_path(hand, angles)
    np.testing.assert_allclose(path[-1], opened)
    here = angles
    for there in path:
        assert self_penetration(hand, here + np.linspace(0.0, 1.0, 40)[:, None] * (there - here)).max() <= 0.00105
        here = there
