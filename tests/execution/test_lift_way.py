"""Ways up for a held object: straight where nothing is above, out first where a lid is, none in a closed box."""

import numpy as np
import pytest
import trimesh

from dexnudge.execution.grasp_and_lift import LiftWay
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene

TABLE = box((-0.5, -0.5, -0.04), (0.1, 0.5, 0.0))  # its edge is at x = 0.1, the motion's direction


def scene_of(*bodies: trimesh.Trimesh) -> Scene:
    pose = np.eye(4)
    pose[:3, 3] = 0.0, 0.0, 0.01
    block = trimesh.creation.box((0.16, 0.06, 0.02))
    return Scene(block, trimesh.util.concatenate([TABLE, *bodies]), pose, np.array([1.0, 0.0, 0.0]))


@pytest.fixture
def beyond(small_hand) -> np.ndarray:
    """The hand far in front of the table, where nothing stops it: only the object counts."""
    return np.array([2.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])


def test_straight_up_from_a_table(small_hand, beyond):
    ways = LiftWay(small_hand, scene_of(), height=0.1)(beyond)
    np.testing.assert_allclose(ways, [[0.0, 0.0, 0.1]])


def test_out_from_under_a_lid_before_it_goes_up(small_hand, beyond):
    lid = box((-0.5, -0.5, 0.04), (0.0, 0.5, 0.06))  # its front edge is at x = 0; the object reaches back to -0.08
    ways = LiftWay(small_hand, scene_of(lid), height=0.1)(beyond)
    shifts = np.array(ways)
    np.testing.assert_allclose(shifts.sum(axis=0)[2], 0.1)
    outward = shifts[1]
    np.testing.assert_allclose(outward, [0.08, 0.0, 0.0])  # of 0, 40, 80 ... mm the first that clears the lid's edge


def test_a_hand_below_a_lid_stops_the_lift(small_hand):
    lid = box((1.5, -0.5, 0.10), (2.5, 0.5, 0.12))  # 40 mm above the hand alone
    q = np.array([2.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    ways = LiftWay(small_hand, scene_of(lid), height=0.1)(q)
    assert ways is None


def test_no_way_out_of_a_box(small_hand, beyond):
    walls = [box((0.09, -0.5, 0.0), (0.1, 0.5, 0.2)), box((-0.5, -0.5, 0.05), (0.1, 0.5, 0.06))]
    assert LiftWay(small_hand, scene_of(*walls), height=0.1)(beyond) is None
