"""Points spread over a surface: on it, apart from each other, and leaving no gap."""

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from dexnudge.geometry.surface_points import PIECE, random_points, surface_points
from dexnudge.hands.link_meshes import gymnasium_mesh

MESHES = {
    "box": lambda: trimesh.creation.box((0.12, 0.05, 0.01)),
    "sphere": lambda: trimesh.creation.icosphere(subdivisions=3, radius=0.02),
    "finger": lambda: gymnasium_mesh("F2"),
}


@pytest.mark.parametrize("spacing", [0.002, 0.006])
@pytest.mark.parametrize("name", MESHES)
def test_gaps(name, spacing):
    mesh = MESHES[name]()
    points = surface_points(mesh, spacing=spacing).points
    apart, _ = cKDTree(points).query(points, k=2)
    assert apart[:, 1].min() >= spacing / np.sqrt(2) - 1e-12
    rng = np.random.default_rng(7)
    faces = rng.choice(len(mesh.faces), 20_000, p=mesh.area_faces / mesh.area)
    places = (rng.dirichlet((1, 1, 1), 20_000)[:, :, None] * mesh.triangles[faces]).sum(axis=1)
    gap, _ = cKDTree(points).query(places)
    assert gap.max() <= 1.1 * spacing
    assert (gap <= spacing / np.sqrt(2)).mean() > 0.98


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("count", [1, PIECE, 2 * PIECE + 3])
def test_random_points_are_those_of_trimesh_to_the_last_bit(name, count):
    mesh = MESHES[name]()
    places, faces = trimesh.sample.sample_surface(mesh, count, seed=np.random.default_rng(3))
    found, triangles = random_points(mesh, count, np.random.default_rng(3))
    np.testing.assert_array_equal(found, places)
    np.testing.assert_array_equal(triangles, faces)


@pytest.mark.parametrize("name", MESHES)
def test_points_lie_on_the_surface_with_its_normals(name):
    mesh = MESHES[name]()
    spread = surface_points(mesh, spacing=0.003)
    squared, faces, _ = igl.point_mesh_squared_distance(spread.points, mesh.vertices, mesh.faces)
    assert squared.max() < 1e-14
    np.testing.assert_allclose(np.linalg.norm(spread.normals, axis=1), 1.0, atol=1e-9)
    cosines = (spread.normals * mesh.face_normals[faces]).sum(axis=1)
    assert np.mean(cosines > 0.99) > 0.6  # inside faces; on edges and corners the normal is the mean of its faces
    assert cosines.min() > -1e-6


def test_sharp_corners_are_kept():
    mesh = trimesh.creation.box((0.03, 0.02, 0.01))
    gap, _ = cKDTree(surface_points(mesh, spacing=0.004).points).query(mesh.vertices)
    assert gap.max() == 0.0


def test_same_seed_same_points():
    mesh = MESHES["finger"]()
    first, again, other = (surface_points(mesh, spacing=0.003, seed=seed).points for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first[-10:], other[-10:])


def test_empty_mesh_has_no_points():
    assert len(surface_points(trimesh.Trimesh(), spacing=0.002).points) == 0
