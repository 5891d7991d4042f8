import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.geometry.surface_points import surface_points
from dexnudge.hands.hand import LinkPoints
from dexnudge.verification.point_tree import PointTree, SolidDistance, build_tree, hole_diameter, query_tree


@pytest.fixture(scope="module")
def tree() -> PointTree:
    """Points of a box (link 0) and a ball (link 2)."""
    parts = [
        (0, surface_points(trimesh.creation.box((0.06, 0.03, 0.02)), spacing=3e-3)),
        (2, surface_points(trimesh.creation.icosphere(subdivisions=3, radius=0.02), spacing=3e-3)),
    ]
    return build_tree(
        LinkPoints(
            np.concatenate([part.points for _, part in parts]),
            np.concatenate([part.normals for _, part in parts]),
            np.concatenate([np.full(len(part.points), link, dtype=np.int32) for link, part in parts]),
        )
    )


def open_box() -> trimesh.Trimesh:
    """A box whose 20 mm square lid is missing."""
    box = trimesh.creation.box((0.02, 0.02, 0.03))
    box.update_faces(box.face_normals[:, 2] < 0.5)
    return box


def test_balls_hold_their_clusters_and_the_last_level_is_the_points(tree: PointTree) -> None:
    points = tree.points.points
    below = [[index] for index in range(len(tree.levels[-1].point))]
    assert sorted(tree.levels[-1].point) == list(range(len(points)))
    for level in reversed(tree.levels[:-1]):
        spans = zip(level.first_child, level.children, strict=True)
        members = [[own for child in below[first : first + count] for own in child] for first, count in spans]
        for own, point, radius in zip(members, level.point, level.radius, strict=True):
            index = tree.levels[-1].point[own]
            assert np.linalg.norm(points[index] - points[point], axis=1).max() <= radius + 1e-12
            assert len(set(tree.points.link[index])) == 1
        assert sorted(own for part in members for own in part) == list(range(len(points)))
        below = members


@pytest.mark.parametrize("solid_mesh", [trimesh.creation.capsule(radius=0.02, height=0.05), open_box()])
def test_hits_equal_a_query_of_every_point(tree: PointTree, solid_mesh: trimesh.Trimesh) -> None:
    rng = np.random.default_rng(0)
    solid = SolidDistance(solid_mesh)
    poses = np.tile(np.eye(4), (12, 3, 1, 1))
    poses[:, :, :3, :3] = Rotation.random(36, random_state=0).as_matrix().reshape(12, 3, 3, 3)
    poses[:, :, :3, 3] = rng.uniform(-0.04, 0.04, (12, 3, 3))
    links = np.ones(3, dtype=bool)
    found = query_tree(tree, poses, solid, links=links, reach=2e-3)
    deepest = np.zeros(12)
    query_tree(tree, poses, solid, links=links, reach=0.0, deepest=deepest)
    for row in range(12):
        own = poses[row, tree.points.link]
        placed = np.einsum("pij,pj->pi", own[:, :3, :3], tree.points.points) + own[:, :3, 3]
        hit = solid.query(placed)
        near = np.flatnonzero(hit.distance <= 2e-3)
        mine = found.configuration == row
        order = np.argsort(found.point[mine])
        np.testing.assert_array_equal(found.point[mine][order], near)
        np.testing.assert_array_equal(found.distance[mine][order], hit.distance[near])
        assert deepest[row] == max(0.0, -hit.distance.min())
    assert (deepest > 0).any()


def test_only_the_chosen_links_are_asked(tree: PointTree) -> None:
    solid = SolidDistance(trimesh.creation.box((0.1, 0.1, 0.1)))
    poses = np.tile(np.eye(4), (1, 3, 1, 1))
    found = query_tree(tree, poses, solid, links=np.array([False, False, True]), reach=0.0)
    assert set(tree.points.link[found.point]) == {2}


def test_the_size_of_holes_is_known() -> None:
    assert hole_diameter(trimesh.creation.box((1, 1, 1))) == 0.0
    assert hole_diameter(open_box()) == pytest.approx(0.02 * np.sqrt(2))
    assert SolidDistance(open_box(), widest_hole=0.01).hole == 0.01
    clashing = open_box()
    clashing.faces[0] = clashing.faces[0, ::-1]
    assert hole_diameter(trimesh.Trimesh(clashing.vertices, clashing.faces, process=False)) == np.inf
