"""Where a hand goes that has let go: nowhere if it can open, else the shortest free way."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from dexnudge.execution import scene_rollout
from dexnudge.execution.scene_rollout import DISTANCES, SceneRollout, opening_path, retreat
from dexnudge.planning.approach import Approach
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.planning.hand_motion import Trajectory
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


class Moved(SceneRollout):
    """A stage whose hand goes where it is told, and whose object lies still."""

    rollout = None

    def __init__(self, hand, scene, q):
        self.hand, self.first, self.path = hand, scene, [q]
        self.rollout = SimpleNamespace(q=q, commanded=q, follow=self.follow)

    def follow(self, path, _phase):
        self.path += list(path)
        self.rollout.q = self.rollout.commanded = self.path[-1]

    def scene_now(self):
        return self.first

    def why_over(self):
        return None


def test_a_hand_in_a_pocket_goes_out_the_way_it_could_have_come(small_hand):
    low, high = np.array([-0.09, -0.034, -0.03]), np.array([0.09, 0.06, 0.055])  # nearest to its back
    walls = []
    for axis, side in ((0, -1), (0, 1), (1, -1), (2, -1), (2, 1)):  # open toward +y, where `retreat` does not look
        corners = np.array([low - 0.01, high + 0.01])
        face = (low if side < 0 else high)[axis]
        corners[:, axis] = np.sort([face, face + 0.01 * side])
        walls.append(box(*corners.tolist()))
    scene = scene_of(*walls)
    assert retreat(small_hand, scene, bent_hand()) is None
    stage = Moved(small_hand, scene, bent_hand())
    stage.go_out()
    path = np.array(stage.path)
    np.testing.assert_allclose(path[[0, 1]], np.tile(bent_hand(), (2, 1)), atol=1e-3)
    assert np.linalg.norm(path[-1, :3]) > 0.1
    assert path[-1, -1] == pytest.approx(0.0, abs=1e-6)  # open
    assert min(HandClearance(small_hand, scene).shifted(q, np.zeros((1, 3))).distance.min() for q in path[::20]) > 0.001


def test_a_hand_backs_off_until_it_is_clear_and_goes_out_where_it_cannot(small_hand, monkeypatch):
    up, open_hand = np.array([0.0, 0.0, 0.03]), [np.zeros(1)]
    approach = Approach(Trajectory(np.zeros(1), bent_hand()[None]), 0.0, "straight")
    for found, out in (([(up, open_hand)] * 2 + [(0 * up, open_hand)], 0), ([(up, open_hand), None], 1)):
        stage, asked, gone = Moved(small_hand, scene_of(), bent_hand()), list(found), []
        monkeypatch.setattr(scene_rollout, "retreat", lambda *_, asked=asked: asked.pop(0))
        monkeypatch.setattr(stage, "go_out", lambda gone=gone: gone.append(True))
        stage.back_off(approach)
        assert (len(asked), len(gone)) == (0, out)


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
