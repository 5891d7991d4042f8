import numpy as np
import trimesh

from dexnudge.geometry.exact_distance import Rays


def naive_hits(triangles, origins, directions):
    """Moeller-Trumbore, every ray against every triangle."""
    a, b, c = triangles.transpose(1, 0, 2)
    distance = np.full(len(origins), np.inf)
    for index, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        p = np.cross(direction, c - a)
        determinant = np.einsum("ij,ij->i", b - a, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", origin - a, p) / determinant
            q = np.cross(origin - a, b - a)
            v = q @ direction / determinant
            t = np.einsum("ij,ij->i", c - a, q) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        distance[index] = t[hit].min(initial=np.inf)
    return distance


def rays_at(triangles):
    return Rays(trimesh.Trimesh(**trimesh.triangles.to_kwargs(triangles), process=False))


def test_distances_equal_those_of_a_double_loop():
    rng = np.random.default_rng(0)
    triangles = np.asarray(trimesh.creation.torus(0.1, 0.04, major_sections=24, minor_sections=12).triangles)
    origins = rng.normal(size=(400, 3))
    directions = rng.normal(size=(400, 3)) * 0.08 - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = naive_hits(triangles, origins, directions)
    distance, face = rays_at(triangles).first_hits(origins, directions, reach=100.0)
    assert 100 < np.isfinite(expected).sum() < 400
    np.testing.assert_array_equal(face >= 0, np.isfinite(expected))
    np.testing.assert_allclose(distance[face >= 0], expected[face >= 0], atol=1e-5)


def test_a_plane_is_as_far_as_geometry_says():
    plane = np.array([[[-9, -9, 0], [9, -9, 0], [9, 9, 0]], [[-9, -9, 0], [9, 9, 0], [-9, 9, 0]]], dtype=float)
    directions = np.array([[0, 0, -1], [0.6, 0, -0.8], [0, 0.8, -0.6], [0, 0, 1]], dtype=float)
    distance, face = rays_at(plane).first_hits(np.tile([0.1, 0.2, 0.5], (4, 1)), directions, reach=100.0)
    np.testing.assert_allclose(distance[:3], [0.5, 0.5 / 0.8, 0.5 / 0.6], rtol=1e-6)
    assert face[3] == -1


def test_no_rays_give_no_hits():
    plane = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float)
    distance, face = rays_at(plane).first_hits(np.zeros((0, 3)), np.zeros((0, 3)), reach=100.0)
    assert len(distance) == len(face) == 0
