"""Exact signed distance against libigl, closed forms, and the properties that every distance has."""

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.hands.link_meshes import gymnasium_mesh

SINGLE_PRECISION = 2e-7  # [m] on meshes of some centimetres
CLEAR_SIGN = 0.1  # points whose winding number is nearer than this to 1/2 sit in a hole: both signs are right


def with_hole():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.042)
    return mesh


def overlapping():
    spheres = [trimesh.creation.icosphere(subdivisions=2, radius=0.03) for _ in range(2)]
    spheres[1].apply_translation((0.03, 0.01, 0))
    return trimesh.util.concatenate(spheres)


MESHES = {
    "palm, not watertight": lambda: gymnasium_mesh("palm"),
    "sphere with a hole": with_hole,
    "overlapping spheres": overlapping,
    "box far from the origin": lambda: trimesh.creation.box((0.1, 0.05, 0.02), np.eye(4) + np.eye(4, k=3)),
}


@pytest.mark.parametrize("name", MESHES)
def test_equals_libigl(name):
    mesh = MESHES[name]()
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [
            rng.uniform(mesh.bounds[0] - 0.02, mesh.bounds[1] + 0.02, (3000, 3)),
            mesh.triangles_center[rng.integers(len(mesh.faces), size=500)] + rng.normal(scale=1e-3, size=(500, 3)),
        ]
    )
    hit = ExactDistance(mesh)(points)
    squared, _, closest = igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces)
    np.testing.assert_allclose(np.abs(hit.distance), np.sqrt(squared), atol=SINGLE_PRECISION)
    winding = igl.winding_number(mesh.vertices, mesh.faces, points)
    clear = (np.abs(winding - 0.5) > CLEAR_SIGN) & (squared > SINGLE_PRECISION**2)
    assert clear.mean() > 0.95
    np.testing.assert_array_equal(hit.distance[clear] < 0, winding[clear] > 0.5)
    unambiguous = np.linalg.norm(hit.closest - closest, axis=1) < 1e-6  # else two places are equally close
    assert unambiguous.mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(points - hit.closest, axis=1), np.sqrt(squared), atol=SINGLE_PRECISION)


@pytest.mark.parametrize("name", MESHES)
def test_to_the_surface_it_is_the_same_without_the_sign_as_far_as_it_looks(name):
    mesh = MESHES[name]()
    points = np.random.default_rng(2).uniform(mesh.bounds[0] - 0.02, mesh.bounds[1] + 0.02, (3000, 3))
    exact = ExactDistance(mesh)
    signed, plain, near = exact(points), exact.to_surface(points), exact.to_surface(points, reach=0.005)
    np.testing.assert_array_equal(plain.distance, np.abs(signed.distance))
    within = plain.distance < 0.005
    assert within.any()
    assert not within.all()
    np.testing.assert_array_equal(near.distance, np.where(within, plain.distance, np.inf))
    for field in ("closest", "normal", "face"):
        np.testing.assert_array_equal(getattr(plain, field), getattr(signed, field))
        np.testing.assert_array_equal(getattr(near, field)[within], getattr(signed, field)[within])


def test_closed_is_a_surface_without_holes_and_with_one_outside():
    clashing = overlapping()
    clashing.faces[0] = clashing.faces[0][::-1]
    found = [ExactDistance(mesh).closed for mesh in (overlapping(), with_hole(), clashing)]
    assert found == [True, False, False]


def test_hole_does_not_turn_the_sign():
    hit = ExactDistance(with_hole())(np.array([[0, 0, 0], [0, 0, 0.02], [0, 0, 0.06], [0, 0.1, 0]]))
    assert (hit.distance < 0).tolist() == [True, True, False, False]


def test_box_in_closed_form():
    half = np.array([0.05, 0.03, 0.01])
    points = np.random.default_rng(1).uniform(-0.08, 0.08, (2000, 3))
    excess = np.abs(points) - half
    expected = np.linalg.norm(np.maximum(excess, 0), axis=1) + np.minimum(excess.max(axis=1), 0)
    hit = ExactDistance(trimesh.creation.box(2 * half))(points)
    np.testing.assert_allclose(hit.distance, expected, atol=SINGLE_PRECISION)
    outside = ((excess > 1e-4).sum(axis=1) == 1) & ((excess > -1e-4).sum(axis=1) == 1)  # above one face, off its rim
    sides = np.where(excess > 1e-4, np.sign(points), 0.0)
    np.testing.assert_allclose(hit.normal[outside], sides[outside], atol=1e-6)


def test_sphere_in_closed_form():
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.04)
    points = np.random.default_rng(2).normal(size=(500, 3)) * 0.04
    expected = np.linalg.norm(points, axis=1) - 0.04
    sagitta = 0.04 - np.linalg.norm(mesh.triangles_center, axis=1).min()  # how far the polyhedron lies inside
    np.testing.assert_allclose(ExactDistance(mesh)(points).distance, expected, atol=1.1 * sagitta)


def test_no_points():
    hit = ExactDistance(trimesh.creation.box((1, 1, 1)))(np.zeros((0, 3)))
    assert (hit.distance.shape, hit.closest.shape, hit.normal.shape, hit.face.shape) == ((0,), (0, 3), (0, 3), (0,))


PALM = gymnasium_mesh("palm")
PALM_DISTANCE = ExactDistance(PALM)
PLACES = st.lists(st.floats(-0.15, 0.15), min_size=3, max_size=3)


@given(PLACES, PLACES)
@settings(deadline=None, max_examples=60)
def test_never_grows_faster_than_the_way(one, other):
    points = np.asarray([one, other])
    first, second = PALM_DISTANCE(points).distance
    winding = igl.winding_number(PALM.vertices, PALM.faces, points)
    if (np.abs(winding - 0.5) > CLEAR_SIGN).all():  # the sign may jump inside a hole of the mesh
        assert abs(first - second) <= np.linalg.norm(points[0] - points[1]) + SINGLE_PRECISION


@given(PLACES, st.lists(st.floats(-3, 3), min_size=3, max_size=3), st.lists(st.floats(-2, 2), min_size=3, max_size=3))
@settings(deadline=None, max_examples=30)
def test_rigid_motion_changes_nothing(place, turn, shift):
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    moved = PALM.copy().apply_transform(motion)
    point = np.asarray([place])
    before = PALM_DISTANCE(point)
    after = ExactDistance(moved)(trimesh.transform_points(point, motion))
    winding = igl.winding_number(PALM.vertices, PALM.faces, point)[0]
    if abs(winding - 0.5) > CLEAR_SIGN and abs(before.distance[0]) > 1e-6:
        np.testing.assert_allclose(after.distance, before.distance, atol=5e-7)
