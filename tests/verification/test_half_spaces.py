"""The half-spaces that rule out surface points: they hold their links, and leave the depths as they are."""

import igl
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.geometry.surface_lattice import surface_lattice
from dexnudge.hands.hand import Hand
from dexnudge.scenes.scene import Scene
from dexnudge.verification.penetration import hand_solids
from dexnudge.verification.solids import DIRECTIONS, SURFACE_SPACING, TriangleSurface


def test_directions_are_units_that_come_in_opposite_pairs() -> None:
    np.testing.assert_allclose(np.linalg.norm(DIRECTIONS, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose((DIRECTIONS @ DIRECTIONS.T).min(axis=1), -1.0, atol=1e-12)


def l_shape() -> trimesh.Trimesh:
    """A closed body with an inner corner."""
    outline = np.array([[0.0, 0.0], [0.04, 0.0], [0.04, 0.01], [0.012, 0.01], [0.012, 0.03], [0.0, 0.03]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    return trimesh.creation.extrude_triangulation(outline, triangles, height=0.015)


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.box((0.03, 0.02, 0.01)), trimesh.creation.capsule(radius=0.01, height=0.03), l_shape()]
)
def test_no_inner_point_is_deeper_than_its_room(mesh: trimesh.Trimesh) -> None:
    extent = (mesh.vertices @ DIRECTIONS.T).max(axis=0)
    points = np.random.default_rng(0).uniform(*mesh.bounds, (2000, 3))
    kind = igl.SIGNED_DISTANCE_TYPE_WINDING_NUMBER
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    distance = igl.signed_distance(points, vertices, faces, sign_type=kind)[0]
    room = (extent - points @ DIRECTIONS.T).min(axis=1)
    inside = distance < 0
    assert inside.sum() > 200
    assert (room[inside] >= -distance[inside] - 1e-9).all()


def touching(hand: Hand, rng: np.random.Generator, count: int) -> np.ndarray:
    """Palms turned at random, so close to the block and the floor that most hands are in one of them."""
    q = np.zeros((count, 9 + hand.num_joints))
    turns = Rotation.random(count, random_state=int(rng.integers(2**31))).as_matrix()
    q[:, 3:9] = np.concatenate([turns[:, :, 0], turns[:, :, 1]], axis=1)
    q[:, 9:] = rng.uniform(hand.lower, hand.upper, (count, hand.num_joints))
    q[:, :3] = rng.uniform([-0.09, -0.05, 0.0], [0.09, 0.05, 0.06], (count, 3))
    return q


def test_depths_equal_a_query_of_every_surface_point(boxy_hand: Hand, block_scene: Scene) -> None:
    q = touching(boxy_hand, np.random.default_rng(3), 30)
    poses = boxy_hand.forward_kinematics(torch.as_tensor(q)).numpy()
    hand = hand_solids(boxy_hand)
    floor = trimesh.creation.box(bounds=[[-0.1, -0.1, -0.02], [0.1, 0.1, 0.0]])  # small, for the search's sake
    for mesh in (block_scene.object_in_world(), floor):
        triangles = np.asarray(mesh.triangles, dtype=np.float64)
        found = np.zeros(len(q))
        TriangleSurface(mesh).raise_depths(hand.solids, poses[:, hand.links], found)
        surface, _ = surface_lattice(triangles, spacing=SURFACE_SPACING)
        expected = np.zeros(len(q))
        for row, pose in enumerate(poses):
            for link, solid in zip(hand.links, hand.solids.each, strict=True):
                local = trimesh.transform_points(surface, np.linalg.inv(pose[link]))
                expected[row] = max(expected[row], -solid.query(local).distance.min())
        assert (expected > 1e-3).sum() > 10
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_depths_that_are_known_already_are_only_raised(boxy_hand: Hand, block_scene: Scene) -> None:
    q = touching(boxy_hand, np.random.default_rng(4), 20)
    poses = boxy_hand.forward_kinematics(torch.as_tensor(q)).numpy()
    hand, surface = hand_solids(boxy_hand), TriangleSurface(block_scene.environment_mesh)
    fresh, known = np.zeros(20), np.full(20, 0.004)
    surface.raise_depths(hand.solids, poses[:, hand.links], fresh)
    surface.raise_depths(hand.solids, poses[:, hand.links], known)
    np.testing.assert_allclose(known, np.maximum(fresh, 0.004), atol=1e-9)
    assert (fresh > 0.004).any()
    assert (fresh < 0.004).any()


def test_a_surface_is_the_same_whatever_was_asked_before(boxy_hand: Hand, block_scene: Scene) -> None:
    poses = boxy_hand.forward_kinematics(torch.as_tensor(touching(boxy_hand, np.random.default_rng(5), 20))).numpy()
    hand, mesh = hand_solids(boxy_hand), block_scene.environment_mesh.subdivide_to_size(0.05)
    away, surface = poses[:, hand.links].copy(), TriangleSurface(mesh)
    away[..., :3, 3] += [0.0, 0.0, 2.0]
    depths = [np.zeros(20) for _ in range(3)]
    surface.raise_depths(hand.solids, away, depths[0])
    surface.raise_depths(hand.solids, poses[:, hand.links], depths[1], clearance=1e-3)
    TriangleSurface(mesh).raise_depths(hand.solids, poses[:, hand.links], depths[2], clearance=1e-3)
    assert not depths[0].any()
    assert (depths[1] > 1e-3).any()
    np.testing.assert_array_equal(depths[1], depths[2])
