"""How objects come to lie, against exact shapes and trimesh's stable poses."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.resting import resting_pose


def laid(mesh: trimesh.Trimesh) -> np.ndarray:
    pose = resting_pose(mesh)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    return mesh.vertices @ pose[:3, :3].T + pose[:3, 3]


@settings(max_examples=30)
@given(st.permutations([0.15, 0.07, 0.01]), st.integers(0, 2**16))
def test_a_block_lies_flat_with_its_long_side_along_x_however_it_is_given(size, seed):
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3)))
    placed = laid(mesh)
    np.testing.assert_allclose(placed.min(axis=0), [-0.075, -0.035, 0], atol=1e-9)
    np.testing.assert_allclose(placed.max(axis=0), [0.075, 0.035, 0.01], atol=1e-9)
    assert np.count_nonzero(placed[:, 2] < 1e-9) == 4


def test_ties_go_to_the_side_that_is_down_already():
    np.testing.assert_allclose(resting_pose(trimesh.creation.box((0.15, 0.07, 0.01)))[:3, :3], np.eye(3), atol=1e-12)


def test_a_cone_lies_on_its_base():
    cone = trimesh.creation.cone(0.05, 0.04, sections=32)
    cone.apply_transform(trimesh.transformations.rotation_matrix(2.0, [1, 2, 3]))
    placed = laid(cone)
    assert np.count_nonzero(placed[:, 2] < 1e-9) >= 32
    assert placed[:, 2].max() == pytest.approx(0.04)


def test_a_camera_block_points_up():
    placed = laid(builtin_object("phone"))
    assert np.count_nonzero(placed[:, 2] < 1e-9) > 100
    assert np.count_nonzero(placed[:, 2] > placed[:, 2].max() - 1e-6) < 60


@pytest.mark.parametrize("name", ["phone-001", "phone-002", "phone-004", "remote-001", "remote-002", "book", "box-003"])
def test_it_is_the_most_probable_of_trimesh_stable_poses(name):
    mesh = builtin_object(name)
    transforms, probability = trimesh.poses.compute_stable_poses(mesh)
    down = resting_pose(mesh)[2, :3]
    # Equal faces of a symmetric object share the first place.
    best = [t[2, :3] for t, p in zip(transforms, probability, strict=True) if p > 0.9 * probability.max()]
    assert max(float(down @ other) for other in best) > np.cos(np.radians(6))


@pytest.mark.parametrize("name", ["phone-003", "phone-008", "remote-003", "remote-004", "remote-200", "tablet-000"])
def test_the_centre_of_mass_stands_over_the_points_that_touch(name):
    mesh = builtin_object(name)
    pose = resting_pose(mesh)
    placed = laid(mesh)
    touching = placed[placed[:, 2] < 1e-6][:, :2]
    centre = (pose[:3, :3] @ centre_of_mass(mesh) + pose[:3, 3])[:2]
    equations = ConvexHull(touching).equations
    assert (equations[:, :2] @ centre + equations[:, 2]).max() < 1e-9
