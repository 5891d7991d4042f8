import numpy as np
import trimesh

from dexnudge.viewer.picture import corner_normals
from dexnudge.viewer.visual_scene import CREASE_ANGLE


def naive_corner_normals(mesh):
    result = np.zeros((len(mesh.faces), 3, 3))
    for face, corners in enumerate(mesh.triangles):
        for corner, place in enumerate(corners):
            total = np.zeros(3)
            for other in range(len(mesh.faces)):
                touches = (np.abs(mesh.triangles[other] - place).max(axis=1) < 1e-9).any()
                bend = mesh.face_normals[face] @ mesh.face_normals[other]
                if touches and bend > np.cos(np.radians(CREASE_ANGLE)):
                    total += mesh.area_faces[other] * mesh.face_normals[other]
            result[face, corner] = total / np.linalg.norm(total)
    return result


def test_equal_to_a_naive_loop_also_when_vertices_are_not_shared():
    mesh = trimesh.creation.capsule(height=0.1, radius=0.03, count=[6, 6])
    np.testing.assert_allclose(corner_normals(mesh), naive_corner_normals(mesh), atol=1e-9)
    soup = trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)
    np.testing.assert_allclose(corner_normals(soup), naive_corner_normals(mesh), atol=1e-9)


def test_a_box_stays_sharp_and_a_sphere_is_smooth():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    np.testing.assert_allclose(corner_normals(box), np.repeat(box.face_normals[:, None], 3, axis=1), atol=1e-12)
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    outward = sphere.triangles / 0.1
    assert np.einsum("fcx,fcx->fc", corner_normals(sphere), outward).min() > np.cos(np.radians(1.0))


def test_a_triangle_without_area_gets_some_unit_normal():
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False)
    np.testing.assert_allclose(np.linalg.norm(corner_normals(mesh), axis=2), 1.0)
