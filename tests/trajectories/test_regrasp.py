"""How far an object is pushed before it is grasped, and the way of the hand that lifts it."""

from dataclasses import replace

import numpy as np
import pytest

from dexnudge.execution.slide_grasp_lift import overhang
from dexnudge.planning.object_path import push_length
from dexnudge.scenes.families import build_scene
from dexnudge.trajectories.regrasp import _carried, graspable_length


def test_the_object_is_pushed_until_enough_of_it_is_free():
    scene = build_scene("table", "phone", seed=0)
    length = graspable_length(scene)
    assert length > push_length(scene)
    pose = scene.T_world_object.copy()
    pose[:3, 3] += length * scene.motion
    assert 0.35 < overhang(replace(scene, T_world_object=pose)) < 0.5


def test_an_object_with_no_edge_in_reach_is_pushed_as_far_as_the_scene_says(block_scene):
    wide = block_scene.environment_mesh.copy()
    wide.vertices[:, :2] *= 10.0
    assert graspable_length(replace(block_scene, environment_mesh=wide, motion_length=0.02)) == pytest.approx(0.02)


def test_a_lift_goes_through_its_corners_in_small_steps():
    q = np.arange(12.0)
    ways = [np.array([0.0, 0.0, 0.004]), np.array([0.04, 0.0, 0.0]), np.array([0.0, 0.0, 0.096])]
    rows = _carried(q, ways)
    np.testing.assert_array_equal(rows[:, 3:], np.tile(q[3:], (len(rows), 1)))
    moved = rows[:, :3] - q[:3]
    np.testing.assert_allclose(moved[-1], [0.04, 0.0, 0.1], atol=1e-12)
    assert np.linalg.norm(np.diff(moved, axis=0), axis=1).max() <= 0.004 + 1e-12
    assert (np.abs(moved - [0.04, 0.0, 0.004]).max(axis=1) < 1e-12).any()
