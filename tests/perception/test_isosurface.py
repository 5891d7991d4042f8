"""Surfaces of grids against exact shapes."""

import numpy as np
import trimesh

from dexnudge.perception.fusion import isosurface


def test_a_sphere_has_its_volume_and_faces_outward():
    grid = np.stack(np.meshgrid(*[np.arange(40.0)] * 3, indexing="ij"), axis=-1)
    vertices, faces, _ = isosurface(np.linalg.norm(grid - 19.3, axis=-1) - 15)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.volume, 4 / 3 * np.pi * 15**3, rtol=0.005)
    np.testing.assert_allclose(np.linalg.norm(vertices - 19.3, axis=1), 15, atol=0.02)


def test_any_values_give_a_closed_surface_between_nodes_of_unlike_sign():
    values = np.random.default_rng(0).normal(size=(20, 21, 22))
    values = np.pad(np.where(np.abs(values) < 0.3, 0.0, values), 1, constant_values=1.0)
    vertices, faces, nodes = isosurface(values)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 0
    assert ((nodes[:, 1] - nodes[:, 0]).sum(axis=1) == 1).all()
    first, second = values[tuple(nodes[:, 0].T)], values[tuple(nodes[:, 1].T)]
    assert ((first < 0) != (second < 0)).all()
    way = np.abs(first) / (np.abs(first) + np.abs(second))
    expected = nodes[:, 0] + way[:, None] * (nodes[:, 1] - nodes[:, 0])
    np.testing.assert_allclose(vertices, expected, atol=0.01)


def test_values_of_one_sign_have_no_surface():
    vertices, faces, nodes = isosurface(np.ones((4, 4, 4)))
    assert (vertices.shape, faces.shape, nodes.shape) == ((0, 3), (0, 3), (0, 2, 3))
