"""A scanned world has the errors that were asked for, and no others."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.experiments.config import ScanErrors
from dexnudge.experiments.scanned_world import remeshed, scanned_mesh, scanned_world, tilted
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.perception.views import load_views, save_views
from dexnudge.scenes.families import build_scene

EXACT = {"triangle_mm": 0.0, "rounding_mm": 0.0}


@pytest.fixture(scope="module")
def shelf():
    return build_scene("shelf", "phone", seed=1)


def angle(rotation) -> float:
    """Angle of a rotation [deg]."""
    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))


def test_without_errors_everything_is_given_as_it_is(shelf):
    world = scanned_world(shelf, ScanErrors(**EXACT), seed=3)
    assert world.truth is shelf
    understood = world.understood()
    for name in ("T_world_object", "motion", "motion_length", "mass", "friction_hand", "friction_environment"):
        np.testing.assert_array_equal(getattr(understood, name), getattr(shelf, name))
    np.testing.assert_array_equal(understood.environment_mesh.vertices, shelf.environment_mesh.vertices)


@pytest.mark.parametrize("degrees", [0.5, 2.0])
def test_the_true_world_is_tilted_and_the_given_motion_is_not(shelf, degrees):
    world = scanned_world(shelf, ScanErrors(tilt_deg=degrees, **EXACT), seed=3)
    turn = world.truth.T_world_object[:3, :3] @ shelf.T_world_object[:3, :3].T
    assert angle(turn) == pytest.approx(degrees)
    assert Rotation.from_matrix(turn).as_rotvec()[2] == pytest.approx(0.0, abs=1e-12)  # a horizontal axis
    np.testing.assert_allclose(world.truth.motion, turn @ shelf.motion, atol=1e-12)
    np.testing.assert_array_equal(world.motion, shelf.motion)
    np.testing.assert_array_equal(world.object_pose, world.truth.T_world_object)
    for scene in (shelf, world.truth):  # the surroundings turn with the object
        scene.validate()
    seen = [
        each.environment_mesh.copy().apply_transform(np.linalg.inv(each.T_world_object)).vertices
        for each in (shelf, world.truth)
    ]
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-9)


def test_the_pose_is_off_by_what_was_asked_for(shelf):
    world = scanned_world(shelf, ScanErrors(pose_mm=2.0, pose_deg=1.0, tilt_deg=0.5, **EXACT), seed=3)
    off = world.object_pose @ np.linalg.inv(world.truth.T_world_object)
    centre = world.truth.object_in_world().center_mass
    assert 1e3 * np.linalg.norm(off[:3, :3] @ centre + off[:3, 3] - centre) == pytest.approx(2.0)
    assert angle(off[:3, :3]) == pytest.approx(1.0)


def test_one_seed_gives_one_direction_of_each_error_at_any_size(shelf):
    small, large = (
        scanned_world(shelf, ScanErrors(pose_mm=mm, tilt_deg=mm, noise_mm=mm / 2, **EXACT), seed=3) for mm in (1.0, 2.0)
    )
    moved = [(each.object_pose - each.truth.T_world_object)[:3, 3] for each in (small, large)]
    np.testing.assert_allclose(2 * moved[0], moved[1], atol=1e-9)
    level = [tilted(shelf, 0.0, np.random.default_rng(0)).environment_mesh.vertices for _ in range(2)]
    np.testing.assert_array_equal(*level)
    other = scanned_world(shelf, ScanErrors(pose_mm=1.0, **EXACT), seed=4)
    assert not np.allclose(other.object_pose[:3, 3] - shelf.T_world_object[:3, 3], moved[0], atol=1e-4)


def test_triangles_are_small_and_the_surface_stays(shelf):
    mesh = shelf.environment_mesh
    fine = remeshed(mesh, 0.008)
    assert fine.edges_unique_length.max() <= 1.6 * 0.008
    assert 0.006 < fine.edges_unique_length.mean() < 0.010
    assert fine.is_watertight
    assert fine.is_winding_consistent
    assert fine.area == pytest.approx(mesh.area, rel=1e-9)
    assert fine.volume == pytest.approx(mesh.volume, rel=1e-9)
    assert np.abs(ExactDistance(mesh)(np.asarray(fine.vertices)).distance).max() < 1e-5  # single precision
    assert fine.body_count == mesh.body_count


def test_vertices_scatter_along_their_normals_and_are_rounded():
    slab = trimesh.creation.box(bounds=[[-0.3, -0.3, -0.02], [0.3, 0.3, 0.0]])
    errors = ScanErrors(noise_mm=1.0, triangle_mm=8.0, rounding_mm=0.01)
    still = scanned_mesh(slab, ScanErrors(triangle_mm=8.0, rounding_mm=0.0), np.random.default_rng(0))
    found = scanned_mesh(slab, errors, np.random.default_rng(0))
    inner = (np.abs(still.vertices[:, :2]) < 0.299).all(axis=1) & (still.vertices[:, 2] == 0.0)
    assert inner.sum() > 3000
    moved = found.vertices[inner] - still.vertices[inner]
    assert 1e3 * moved[:, 2].std() == pytest.approx(1.0, rel=0.05)
    assert np.abs(moved[:, :2]).max() <= 0.51e-5  # rounding alone
    np.testing.assert_allclose(found.vertices * 1e5, np.rint(found.vertices * 1e5), atol=1e-6)


def test_depth_is_rendered_of_the_tilted_world(shelf, tmp_path):
    world = scanned_world(shelf, ScanErrors(tilt_deg=2.0, depth_views=2), seed=3)
    assert world.surroundings is None
    assert len(load_views(save_views(world.views, tmp_path))) == 2
    body = ExactDistance(world.truth.object_in_world())
    for view in world.views:
        points = view.points(view.mask)
        assert (
            np.median(np.abs(body(points).distance)) < 0.003
        )  # the camera's noise; the level object is 2 mm off and more


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"noise_mm": -1.0}, "`noise_mm` is -1; expected 0 to 10"),
        ({"tilt_deg": 45.0}, "`tilt_deg` is 45; expected 0 to 30"),
        ({"depth_views": 13}, "`depth_views` is 13; expected 0 to 12"),
        (
            {"depth_views": 2, "triangle_mm": 4.0},
            (
                "`triangle_mm` does nothing with `depth_views`, whose camera has its own noise; expected one of them; "
                "leave `triangle_mm` out"
            ),
        ),
        ({"pose_mm": float("nan")}, "`pose_mm` is nan; expected 0 to 50"),
    ],
)
def test_errors_that_make_no_sense_are_refused(given, message):
    with pytest.raises(InputError) as refusal:
        ScanErrors(**given)
    assert str(refusal.value) == message
