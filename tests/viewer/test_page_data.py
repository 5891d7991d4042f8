import base64

import numpy as np
import pytest
import trimesh

from dexnudge.geometry.coarsening import LARGEST_MESH, thinned
from dexnudge.viewer.page_data import page_geometry
from dexnudge.viewer.picture import corner_normals


def decoded(text, dtype, columns=None):
    array = np.frombuffer(base64.b64decode(text), dtype=dtype)
    return array.reshape(-1, columns) if columns else array


@pytest.mark.parametrize("subdivisions", [2, 5])
def test_a_page_holds_the_same_triangles_and_normals(subdivisions):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.1)
    mesh.apply_translation([0.5, 0.2, -0.3])
    packed = page_geometry(mesh)
    positions, normals = decoded(packed["positions"], "<f4", 3), decoded(packed["normals"], "i1", 4)
    indices = decoded(packed["indices"], {2: "<u2", 4: "<u4"}[packed["index_bytes"]], 3)
    np.testing.assert_allclose(positions[indices], mesh.triangles, atol=1e-7)
    np.testing.assert_allclose(normals[indices][..., :3] / 127, corner_normals(mesh), atol=0.005)
    assert packed["closed"]


def test_edges_are_those_of_the_box():
    ends = decoded(page_geometry(trimesh.creation.box((0.2, 0.2, 0.2)))["edges"], "<f4", 3).reshape(-1, 2, 3)
    assert len(ends) == 12
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 0.2, rtol=1e-6)


def test_a_fine_mesh_is_thinned_but_keeps_its_shape():
    fine = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    light = thinned(fine)
    assert len(fine.faces) > LARGEST_MESH >= len(light.faces) > LARGEST_MESH / 20
    np.testing.assert_allclose(np.linalg.norm(light.vertices, axis=1), 0.1, atol=0.0005)
    assert light.volume == pytest.approx(fine.volume, rel=0.01)


def test_a_coarse_mesh_is_left_alone():
    mesh = trimesh.creation.box()
    assert thinned(mesh) is mesh
