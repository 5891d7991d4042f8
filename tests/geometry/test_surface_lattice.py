import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from dexnudge.geometry.surface_lattice import Boxes, lattice_in_boxes, surface_lattice

SPACING = 2e-3


def test_every_place_of_a_surface_has_a_point_within_reach() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    points, face = surface_lattice(np.asarray(mesh.triangles), spacing=SPACING)
    anywhere = trimesh.sample.sample_surface(mesh, 4000, seed=0)[0]
    gap = cKDTree(points).query(anywhere)[0]
    assert gap.max() <= SPACING / np.sqrt(2) + 1e-9
    nearest = trimesh.triangles.closest_point(mesh.triangles[face], points)
    np.testing.assert_allclose(points, nearest, atol=1e-9)


def test_corners_and_edges_are_held() -> None:
    mesh = trimesh.creation.box((0.1, 0.05, 0.01))
    tree = cKDTree(surface_lattice(np.asarray(mesh.triangles), spacing=SPACING)[0])
    assert tree.query(mesh.vertices)[0].max() <= 1e-12
    along = np.linspace(mesh.vertices[mesh.edges[:, 0]], mesh.vertices[mesh.edges[:, 1]], 301).reshape(-1, 3)
    assert tree.query(along)[0].max() <= SPACING / 2 + 1e-9


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_in_boxes_lie_exactly_the_lattice_points_that_boxes_hold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-0.03, 0.03, (6, 3, 3))
    turns = Rotation.random(3, random_state=int(rng.integers(2**31))).as_matrix()
    boxes = Boxes(rng.uniform(-0.03, 0.03, (3, 3)), turns, rng.uniform(0.002, 0.02, (3, 3)))
    everything = surface_lattice(triangles, spacing=SPACING)[0]
    points, owner, face = lattice_in_boxes(triangles, boxes, spacing=SPACING)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert np.abs(((points - triangles[face, 0]) * normals[face]).sum(axis=1)).max(initial=0.0) <= 1e-9
    for box in range(3):
        local = (everything - boxes.centre[box]) @ boxes.axes[box].T
        expected = everything[np.all(np.abs(local) <= boxes.half[box] - 1e-12, axis=1)]
        found = points[owner == box]
        assert len(found) == pytest.approx(len(expected), abs=1)  # a point on a box's face may fall on either side
        if len(expected):
            assert cKDTree(found).query(expected)[0].max() <= 1e-9


def test_flat_and_missing_triangles_have_edges_or_nothing() -> None:
    line = np.array([[[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]]])
    points, face = surface_lattice(line, spacing=SPACING)
    assert np.ptp(points[:, 0]) == pytest.approx(0.02)
    assert not points[:, 1:].any()
    assert not face.any()
    nothing = Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    assert len(lattice_in_boxes(line, nothing, spacing=SPACING)[0]) == 0
    assert len(surface_lattice(np.zeros((0, 3, 3)), spacing=SPACING)[0]) == 0
