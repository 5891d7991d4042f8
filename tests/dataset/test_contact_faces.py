"""On a box every face is known; on any body the normal is that of the triangle under the point."""

import numpy as np
import pytest
import trimesh

from dexnudge.dataset.info import FACES, NORMALS, OCTANTS, contact_faces, palm_octants, surface_normals
from dexnudge.geometry.surface_points import object_cloud
from dexnudge.objects.builtin import builtin_object
from dexnudge.synthesis.object_data import at_rest

HALF = np.array([0.075, 0.036, 0.005])  # a phone


@pytest.mark.parametrize("side", FACES)
def test_points_on_a_thin_box(side):
    rng = np.random.default_rng(3)
    axis, sign = np.nonzero(NORMALS[FACES.index(side)])[0][0], NORMALS[FACES.index(side)].sum()
    points = rng.uniform(-0.97, 0.97, (200, 3)) * HALF  # up to 0.15 mm from the edge of the thin side
    points[:, axis] = sign * HALF[axis]
    cloud = object_cloud(trimesh.creation.box(2 * HALF)).numpy().astype(np.float64)
    found = contact_faces(points, cloud)
    assert (found == FACES.index(side)).mean() > 0.97  # at an edge the two sides are as good


def test_normals_of_a_curved_body_against_its_triangles():
    mesh = at_rest(builtin_object("remote-203"))
    points, faces = trimesh.sample.sample_surface(mesh, 500, seed=0)
    cloud = object_cloud(mesh).numpy().astype(np.float64)
    cosines = (surface_normals(np.asarray(points), cloud) * mesh.face_normals[faces]).sum(axis=1)
    assert np.median(cosines) > 0.99
    assert np.quantile(cosines, 0.05) > 0.7


def test_no_contacts():
    assert contact_faces(np.zeros((0, 3)), np.zeros((4, 6))).shape == (0,)


def test_octants_are_centred_on_the_axes():
    angles = np.radians(np.arange(8) * 45.0)
    at = np.stack([np.cos(angles), np.sin(angles), np.zeros(8)], axis=1)
    assert palm_octants(at).tolist() == list(range(8))
    names = {(1, 0): "+x", (0, 1): "+y", (-1, 0): "-x", (0, -1): "-y", (1, 1): "+x+y", (1, -1): "+x-y"}
    for (x, y), name in names.items():
        assert OCTANTS[palm_octants(np.array([[x, y, 0.3]]))[0]] == name
