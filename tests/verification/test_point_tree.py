import tracemalloc

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.geometry.surface_points import surface_points
from dexnudge.hands.hand import LinkPoints
from dexnudge.verification import point_tree
from dexnudge.verification.point_tree import PointTree, build_tree, near_points, raise_depths
from dexnudge.verification.solids import SolidDistance, Solids, hole_diameter


def test_building_takes_no_more_than_a_few_numbers_a_point() -> None:
    count = 20_000
    points = np.random.default_rng(0).random((count, 3))
    tracemalloc.start()
    try:
        tree = build_tree(LinkPoints(points, points, np.zeros(count, dtype=np.int32)), num_links=1)
        assert tracemalloc.get_traced_memory()[1] < 150 * len(tree.index)  # [bytes]; 8 for each number
    finally:
        tracemalloc.stop()


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
        ),
        num_links=3,
    )


def open_box() -> trimesh.Trimesh:
    """A box whose 20 mm square lid is missing."""
    box = trimesh.creation.box((0.02, 0.02, 0.03))
    box.update_faces(box.face_normals[:, 2] < 0.5)
    return box


def test_balls_hold_what_stands_behind_them_and_every_point_is_there_once(tree: PointTree) -> None:
    points, count = tree.points.points, len(tree.index)
    assert sorted(tree.index) == list(range(len(points)))
    assert tree.first.tolist() == [0, (tree.points.link == 0).sum(), (tree.points.link == 0).sum(), count]
    assert (tree.radius > 0).any()
    for node in range(count):
        own = tree.index[node : tree.after[node]]
        assert len(own) >= 1
        assert np.linalg.norm(points[own] - points[tree.index[node]], axis=1).max() <= tree.radius[node] + 1e-12
        assert len(set(tree.points.link[own])) == 1


def clashing_box() -> trimesh.Trimesh:
    """A closed box one of whose triangles is turned round."""
    box = trimesh.creation.box((0.03, 0.02, 0.03))
    box.faces[0] = box.faces[0, ::-1]
    return trimesh.Trimesh(box.vertices, box.faces, process=False)


def two_bodies() -> trimesh.Trimesh:
    """Two closed boxes, one partly in the other."""
    other = trimesh.creation.box((0.03, 0.01, 0.01))
    other.apply_translation([0.012, 0.0, 0.005])
    return trimesh.util.concatenate([trimesh.creation.box((0.02, 0.02, 0.02)), other])


@pytest.mark.parametrize(
    "solid_mesh", [trimesh.creation.capsule(radius=0.02, height=0.05), open_box(), clashing_box(), two_bodies()]
)
def test_hits_and_depths_equal_a_query_of_every_point(tree: PointTree, solid_mesh: trimesh.Trimesh) -> None:
    rng = np.random.default_rng(0)
    solid = SolidDistance(solid_mesh)
    poses = np.tile(np.eye(4), (12, 3, 1, 1))
    poses[:, :, :3, :3] = Rotation.random(36, random_state=0).as_matrix().reshape(12, 3, 3, 3)
    poses[:, :, :3, 3] = rng.uniform(-0.04, 0.04, (12, 3, 3))
    found = near_points(tree, poses, solid, reach=2e-3)
    every, here = np.ones((1, 3), dtype=bool), np.eye(4)[None, None]
    depths = [np.zeros(12), np.zeros(12)]
    for deepest, half_spaces in zip(depths, (False, True), strict=True):
        solids = Solids([solid], half_spaces=half_spaces)
        raise_depths(tree, poses, here, solids, asked=every, reach=0.0, deepest=deepest)
    for row in range(12):
        own = poses[row, tree.points.link]
        placed = np.einsum("pij,pj->pi", own[:, :3, :3], tree.points.points) + own[:, :3, 3]
        hit = solid.query(placed)
        near = np.flatnonzero(hit.distance <= 2e-3)
        mine = found.configuration == row
        order = np.argsort(found.point[mine])
        np.testing.assert_array_equal(found.point[mine][order], near)
        np.testing.assert_array_equal(found.distance[mine][order], hit.distance[near])
        for deepest in depths:
            assert deepest[row] == max(0.0, -hit.distance.min())
    assert (depths[0] > 0).any()


def test_hits_are_the_same_however_many_hands_are_asked_for(tree: PointTree, monkeypatch: pytest.MonkeyPatch) -> None:
    solid = SolidDistance(trimesh.creation.box((0.1, 0.1, 0.1)))
    poses = np.tile(np.eye(4), (10, 3, 1, 1))
    poses[:, :, 0, 3] = np.linspace(0.0, 0.08, 10)[:, None]
    found = near_points(tree, poses, solid, reach=0.0)
    monkeypatch.setattr(point_tree, "AT_ONCE", 3)
    monkeypatch.setattr(point_tree, "EXPECTED_HITS", 1)
    again = near_points(tree, poses, solid, reach=0.0)
    assert len(found.point) > len(tree.index)
    for name in ("configuration", "point", "distance", "closest", "normal"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


def test_only_the_chosen_links_are_asked(tree: PointTree) -> None:
    solids, deepest = Solids([SolidDistance(trimesh.creation.box((0.1, 0.1, 0.1)))]), np.zeros(1)
    poses = np.tile(np.eye(4), (1, 3, 1, 1))
    asked, here = np.array([[False, True, False]]), np.eye(4)[None, None]
    raise_depths(tree, poses, here, solids, asked=asked, reach=0.0, deepest=deepest)
    assert deepest == 0.0
    raise_depths(tree, poses, here, solids, asked=~asked, reach=0.0, deepest=deepest)
    assert deepest > 0.03


def test_the_size_of_holes_is_known() -> None:
    assert hole_diameter(trimesh.creation.box((1, 1, 1))) == 0.0
    assert hole_diameter(open_box()) == pytest.approx(0.02 * np.sqrt(2))
    assert SolidDistance(open_box(), widest_hole=0.01).hole == 0.01
    clashing = open_box()
    clashing.faces[0] = clashing.faces[0, ::-1]
    assert hole_diameter(trimesh.Trimesh(clashing.vertices, clashing.faces, process=False)) == np.inf
    closed = trimesh.creation.box((1, 1, 1))
    closed.faces = [face[::-1] if number == 3 else face for number, face in enumerate(closed.faces)]
    assert closed.is_watertight
    assert hole_diameter(trimesh.Trimesh(closed.vertices, closed.faces, process=False)) == np.inf
