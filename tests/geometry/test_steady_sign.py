"""Where a sign is said to be that of all places around, it is; and that is said of most places."""

import numpy as np
import pytest
import trimesh

from dexnudge.geometry.exact_distance import ExactDistance, open_edges
from dexnudge.geometry.steady_sign import steady_signs

WITHIN = 0.01  # [m]


def bowl() -> trimesh.Trimesh:
    """Half of a sphere about the origin, open above."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.0)
    mesh.remove_unreferenced_vertices()
    return mesh


def test_edges_where_a_surface_ends_are_those_that_triangles_run_along_more_in_one_direction():
    edges, times = open_edges(bowl())
    np.testing.assert_array_equal(times, 1)
    assert np.abs(edges[..., 2]).max() < 0.01  # the rim
    np.testing.assert_allclose((edges[:, 1] - edges[:, 0]).sum(axis=0), 0.0, atol=1e-7)  # once around
    np.testing.assert_allclose(
        np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum(), 2 * np.pi * 0.1, rtol=0.15
    )  # up and down
    assert len(open_edges(trimesh.creation.box((1, 1, 1)))[0]) == 0
    corners, faces = np.eye(3), [[0, 1, 2]]
    np.testing.assert_array_equal(open_edges(trimesh.Trimesh(corners, 2 * faces, process=False))[1], 2)
    assert len(open_edges(trimesh.Trimesh(corners, [*faces, [0, 2, 1]], process=False))[0]) == 0


@pytest.mark.parametrize("shape", ["bowl", "box", "two sheets"])
def test_a_steady_sign_is_that_of_places_around(shape):
    mesh = bowl() if shape == "bowl" else trimesh.creation.box((0.28, 0.28, 0.05))
    if shape == "two sheets":  # between which the winding number is 1 in the middle and a half beside
        mesh.update_faces(np.abs(mesh.face_normals[:, 2]) > 0.5)
    exact, generator = ExactDistance(mesh), np.random.default_rng(0)
    points = generator.uniform(-0.14, 0.14, (400, 3))
    found = steady_signs(exact, points, within=WITHIN)
    steps = generator.normal(size=(400, 50, 3))
    steps *= WITHIN * generator.uniform(0.9, 1.0, (400, 50, 1)) / np.linalg.norm(steps, axis=2, keepdims=True)
    around = points[:, None] + steps
    signs = np.sign(exact(around.reshape(-1, 3)).distance).reshape(400, 50)
    sure = (found != 0) & exact.in_box(around.reshape(-1, 3)).reshape(400, 50).all(axis=1)
    assert (signs[sure] == found[sure, None]).all()
    assert set(found) == {-1, 0, 1}
    assert (found != 0).mean() > 0.5


def test_beyond_its_bounding_box_every_place_is_outside_a_surface():
    exact = ExactDistance(bowl())
    points = np.array([[0.0, 0.0, -0.0999], [0.0, 0.0, -0.1001], [0.099, 0.099, -0.05], [0.0, 0.0, 0.03]])
    np.testing.assert_array_equal(exact.in_box(points), [True, False, True, False])
    assert (exact(points[~exact.in_box(points)]).distance > 0).all()
