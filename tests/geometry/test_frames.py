"""The canonical frame, and hands carried from one frame into another."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.geometry.transforms import canonical_frame, resting_origin, transform_configurations
from dexnudge.hands.named.shadow import shadow_lite

RAMP = np.radians(15.0)
MOTIONS = {
    "level": [np.cos(0.7), np.sin(0.7), 0.0],
    "backward": [-1.0, 0.0, 0.0],
    "up a ramp": [np.cos(RAMP), 0.0, np.sin(RAMP)],
    "down a ramp": [0.0, np.cos(RAMP), -np.sin(RAMP)],
}


def wedge() -> trimesh.Trimesh:
    """A body without any symmetry."""
    mesh = trimesh.convex.convex_hull(np.random.default_rng(3).uniform(-1, 1, (9, 3)) * [0.08, 0.04, 0.01])
    mesh.apply_translation((0.3, -0.2, 0.05))
    return mesh


def rigid(rotation: np.ndarray, translation: np.ndarray | tuple = (0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_axes_are_the_motion_and_up(motion):
    frame = canonical_frame(wedge(), np.asarray(motion))
    rotation = frame[:3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[:, 0], motion, atol=1e-12)
    assert rotation[2, 1] == pytest.approx(0.0), "y is level"
    assert rotation[2, 2] > 0.9, "z points up"
    np.testing.assert_array_equal(frame[3], [0, 0, 0, 1])


@pytest.mark.parametrize("upward", [1.0, -1.0])
def test_a_vertical_motion_leaves_the_worlds_axes(upward):
    frame = canonical_frame(wedge(), np.asarray([0.0, 0.0, upward]))
    np.testing.assert_allclose(frame[:3, :3], np.eye(3), atol=1e-12)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_the_origin_is_the_resting_origin_in_the_frames_own_axes(motion):
    mesh = wedge()
    frame = canonical_frame(mesh, np.asarray(motion))
    mesh.apply_transform(np.linalg.inv(frame))
    np.testing.assert_allclose(resting_origin(mesh), 0.0, atol=1e-9)


def test_the_resting_origin_of_known_bodies():
    box = trimesh.creation.box((0.1, 0.06, 0.02))
    box.apply_translation((1.0, 2.0, 3.0))
    np.testing.assert_allclose(resting_origin(box), [1.0, 2.0, 3.0], atol=1e-9)
    # The centroid of a right triangle lies a third of its legs from the right angle.
    prism = trimesh.creation.extrude_triangulation(
        np.asarray([[0.0, 0.0], [0.3, 0.0], [0.0, 0.6]]), np.asarray([[0, 1, 2]]), 0.02
    )
    np.testing.assert_allclose(resting_origin(prism), [0.1, 0.2, 0.01], atol=1e-9)


@pytest.mark.parametrize("yaw", [0.4, -2.0, np.pi])
def test_the_frame_turns_and_moves_with_the_scene(yaw):
    T = rigid(Rotation.from_euler("z", yaw).as_matrix(), (0.5, -0.1, 0.2))
    motion = np.asarray(MOTIONS["up a ramp"])
    mesh = wedge()
    before = canonical_frame(mesh, motion)
    mesh.apply_transform(T)
    np.testing.assert_allclose(canonical_frame(mesh, T[:3, :3] @ motion), T @ before, atol=1e-9)


def test_the_object_is_left_alone():
    mesh = wedge()
    vertices = np.array(mesh.vertices)
    canonical_frame(mesh, np.asarray([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(mesh.vertices, vertices)


def test_transformed_configurations_have_transformed_links():
    hand = shadow_lite()
    generator = np.random.default_rng(0)
    rotation = Rotation.random(6, random_state=1).as_matrix()
    joints = generator.uniform(hand.lower, hand.upper, (6, hand.num_joints))
    q = np.concatenate([generator.normal(size=(6, 3)), rotation[:, :, 0], rotation[:, :, 1], joints], axis=1)
    untouched = q.copy()
    T_new_old = rigid(Rotation.random(random_state=2).as_matrix(), (0.1, 0.2, -0.3))
    moved = transform_configurations(T_new_old, q)
    before, after = (hand.forward_kinematics(torch.as_tensor(each)).numpy() for each in (q, moved))
    np.testing.assert_allclose(after, T_new_old @ before, atol=1e-12)
    np.testing.assert_array_equal(q, untouched)
    np.testing.assert_allclose(transform_configurations(np.linalg.inv(T_new_old), moved), q, atol=1e-12)
