"""Fused surfaces against the boxes that the cameras saw."""

import dataclasses

import numpy as np
import pytest
import trimesh

from dexnudge.errors import SceneError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.perception import fusion
from dexnudge.perception.fusion import ASSUMED, SEEN, UNSEEN, fuse

LOW, HIGH = np.array([-0.16, -0.16, -0.05]), np.array([0.16, 0.16, 0.16])
TABLE = ((-1, -1, -0.2), (1, 1, 0.001))
BOX = ((-0.05, -0.04, 0.0), (0.06, 0.05, 0.081))
VOXEL = 0.004
EYES = [(0.5 * np.cos(turn), 0.5 * np.sin(turn), 0.4) for turn in np.arange(5) * 2 * np.pi / 5]


def distance(points, *boxes) -> np.ndarray:
    """Signed distance [m] to the union of boxes, outside exact."""
    each = []
    for low, high in boxes:
        beyond = np.maximum(np.subtract(low, points), np.subtract(points, high))
        each.append(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0))
    return np.min(each, axis=0)


def vertices_of(surface, origin) -> np.ndarray:
    return surface.mesh.vertices[np.unique(surface.mesh.faces[surface.origin == origin])]


def inside(surface, points) -> np.ndarray:
    return ExactDistance(surface.mesh)(np.atleast_2d(points)).distance < 0


@pytest.fixture(scope="module")
def views(camera):
    return [camera((TABLE, BOX), eye, (0, 0, 0.03)) for eye in EYES]


@pytest.fixture(scope="module")
def fused(views):
    return fuse(views, LOW, HIGH, voxel=VOXEL)


def test_planes_lie_where_they_are_and_edges_within_a_voxel(fused):
    points = vertices_of(fused, SEEN)
    error = np.abs(distance(points, TABLE, BOX)) / VOXEL
    middle = (np.abs(points[:, :2] - [0.005, 0.005]) < 0.03).all(axis=1)
    around = (np.abs(points[:, :2]) > 0.08).any(axis=1)
    assert middle.sum() > 100
    assert around.sum() > 2000
    assert error[middle].max() < 0.02
    assert error[around].max() < 0.1
    assert np.quantile(error, 0.95) < 0.3
    assert error.max() < 1.0


def test_the_surface_is_closed_and_faces_free_space(fused):
    assert fused.mesh.is_watertight
    assert fused.mesh.is_winding_consistent
    np.testing.assert_allclose(fused.mesh.bounds[0], LOW, atol=1e-9)
    np.testing.assert_allclose(fused.mesh.bounds[1, :2], HIGH[:2], atol=VOXEL)
    up = fused.mesh.face_normals[:, 2] > 0.99
    assert (fused.mesh.triangles_center[up & (fused.origin == SEEN), 2] > 0).all()
    assert inside(fused, [[0, 0, 0.04], [0.12, 0.12, -0.02], [0.12, 0.12, 0.02]]).tolist() == [True, True, False]


def test_every_voxel_is_counted_once(fused):
    counts = np.ceil((HIGH - LOW) / VOXEL - 1e-9).astype(int)
    assert fused.free + fused.seen + fused.unseen == counts.prod()
    assert min(fused.free, fused.seen, fused.unseen) > 1000


def test_the_frame_of_the_world_does_not_matter(views, fused):
    shift = np.array([70.0, -30.0, 5.0])
    moved = [dataclasses.replace(view, T_world_camera=view.T_world_camera.copy()) for view in views]
    for view in moved:
        view.T_world_camera[:3, 3] += shift
    there = fuse(moved, LOW + shift, HIGH + shift, voxel=VOXEL)
    np.testing.assert_allclose(there.mesh.vertices - shift, fused.mesh.vertices, atol=1e-5)


def test_noise_averages_over_pixels_and_views(camera):
    def rms(count: int) -> float:
        seen = [camera((TABLE,), eye, (0, 0, 0), noise=0.002, seed=i) for i, eye in enumerate(EYES[:count])]
        points = vertices_of(fuse(seen, LOW, HIGH, voxel=VOXEL), SEEN)
        return float(np.sqrt((distance(points, TABLE) ** 2).mean()))

    one, five = rms(1), rms(5)
    assert one < 0.0007
    assert five < 0.6 * one


def test_a_thin_box_keeps_both_sides(camera):
    thin = ((-0.05, -0.004, 0.0), (0.05, 0.004, 0.08))
    eyes = [(0.1, 0.5, 0.25), (-0.1, 0.5, 0.25), (0.1, -0.5, 0.25), (-0.1, -0.5, 0.25)]
    found = fuse([camera((TABLE, thin), eye, (0, 0, 0.03), focal=300.0) for eye in eyes], LOW, HIGH, voxel=VOXEL)
    middle = [[x, 0.0, z] for x in (-0.03, 0, 0.03) for z in (0.02, 0.04, 0.06)]
    assert inside(found, middle).all()
    sides = np.array([[x, side, z] for x, _, z in middle for side in (0.008, -0.008)])
    assert not inside(found, sides).any()
    points = vertices_of(found, SEEN)
    upright = (
        (np.abs(points[:, 0]) < 0.04) & (points[:, 2] > 0.02) & (points[:, 2] < 0.07) & (np.abs(points[:, 1]) < 0.02)
    )
    assert np.abs(np.abs(points[upright, 1]) - 0.004).max() < 0.4 * VOXEL


def test_what_is_hidden_is_unseen_and_solid_or_free_as_asked(camera):
    view = camera((TABLE, BOX), (0.5, 0, 0.3), (0, 0, 0.03))
    behind, before = [-0.075, 0.0, 0.02], [0.085, 0.0, 0.02]
    solid, free = (fuse([view], LOW, HIGH, voxel=VOXEL, unseen=kind) for kind in ("solid", "free"))
    assert inside(solid, [behind, before]).tolist() == [True, False]
    assert inside(free, [behind, before]).tolist() == [False, False]
    assert (solid.free, solid.seen, solid.unseen) == (free.free, free.seen, free.unseen)
    shadow = solid.mesh.triangles_center
    shadow = solid.origin[(shadow[:, 0] < -0.07) & (shadow[:, 2] > 0.01) & (np.abs(shadow[:, 1]) < 0.03)]
    assert len(shadow) > 100
    assert (shadow == UNSEEN).all()
    assert np.abs(distance(vertices_of(free, SEEN), TABLE, BOX)).max() < VOXEL


def test_an_edge_before_a_wall_makes_no_surface_between_them(camera):
    wall, post = ((-0.3, -1, -1), (-0.1, 1, 1)), ((0.04, -0.02, -1), (0.08, 0.02, 1))
    found = fuse([camera((wall, post), (0.6, 0.1, 0.05), (0, 0, 0.05))], LOW, HIGH, voxel=VOXEL)
    points = vertices_of(found, SEEN)
    assert np.abs(distance(points, wall, post)).max() < VOXEL
    assert (points[:, 0] > 0.07).sum() > 100
    assert (points[:, 0] < -0.09).sum() > 100


def test_the_object_is_no_surface_and_what_is_before_it_is_free(camera):
    view = camera((TABLE, BOX), (0.5, 0, 0.2), (0, 0, 0.03), objects=[1])
    found = fuse([view], LOW, HIGH, voxel=VOXEL, unseen="free")
    points = vertices_of(found, SEEN)
    assert not ((points[:, 2] > 0.01) & (np.abs(points[:, 1]) < 0.04)).any()
    # Free right up to the object, whose inside nobody saw.
    solid = fuse([view], LOW, HIGH, voxel=VOXEL)
    assert inside(solid, [[0.06 + 0.75 * VOXEL, 0, 0.05], [0.06 - 2 * VOXEL, 0, 0.05]]).tolist() == [False, True]


def test_depth_that_was_completed_is_marked_and_yields_to_what_was_measured(camera):
    eye, target = (0.5, 0, 0.4), (0, 0, 0)
    plain = camera((TABLE,), eye, target)
    hole = np.zeros(plain.depth.shape, dtype=bool)
    hole[40:80, 60:100] = True
    completed = dataclasses.replace(plain, assumed=hole)
    found = fuse([completed], LOW, HIGH, voxel=VOXEL)
    guessed = vertices_of(found, ASSUMED)
    assert len(guessed) > 100
    assert np.abs(distance(guessed, TABLE)).max() < 0.02 * VOXEL
    assert completed.sees(guessed).all()
    wrong = dataclasses.replace(completed, depth=np.where(hole, plain.depth - 0.03, plain.depth))
    other = camera((TABLE,), (0.4, 0.3, 0.4), target)
    points = vertices_of(fuse([wrong, other], LOW, HIGH, voxel=VOXEL), SEEN)
    assert np.quantile(np.abs(distance(points, TABLE)), 0.95) < 0.6 * VOXEL


def test_single_pixels_that_were_completed_among_measured_ones_are_seen(camera):
    plain = camera((TABLE,), (0.3, 0, 0.45), (0, 0, 0), focal=300.0)
    some = np.random.default_rng(1).random(plain.depth.shape) < 0.2
    found = fuse([dataclasses.replace(plain, assumed=some)], LOW, HIGH, voxel=VOXEL)
    assert (found.origin == ASSUMED).sum() < 0.05 * (found.origin == SEEN).sum()


def test_single_pixels_that_drop_out_are_bridged_and_holes_are_not(camera):
    plain = camera((TABLE,), (0.3, 0, 0.45), (0, 0, 0), focal=300.0)
    depth = plain.depth.copy()
    depth[np.random.default_rng(1).random(depth.shape) < 0.3] = 0
    found = fuse([dataclasses.replace(plain, depth=depth)], LOW, HIGH, voxel=VOXEL)
    whole = fuse([plain], LOW, HIGH, voxel=VOXEL)
    assert len(vertices_of(found, SEEN)) > 0.95 * len(vertices_of(whole, SEEN))
    assert np.abs(distance(vertices_of(found, SEEN), TABLE)).max() < 0.05 * VOXEL
    depth[50:70, 70:90] = 0
    holed = fuse([dataclasses.replace(plain, depth=depth)], LOW, HIGH, voxel=VOXEL)
    in_hole = np.zeros(depth.shape, dtype=bool)
    in_hole[58:62, 78:82] = True
    above_hole = plain.points(in_hole) + np.array([0.03, 0, 0.045])
    assert inside(holed, above_hole).all()
    assert not inside(found, above_hole).any()


def test_specks_that_float_are_dropped(camera):
    speck = ((0.0, 0.1, 0.1), (0.008, 0.108, 0.108))
    eyes = [*EYES, (0, 0.01, 0.6)]
    found = fuse([camera((TABLE, speck), eye, (0, 0, 0.03), focal=300.0) for eye in eyes], LOW, HIGH, voxel=VOXEL)
    assert vertices_of(found, SEEN)[:, 2].max() < 0.01


def test_a_large_image_is_thinned_and_gives_the_same_plane(camera, monkeypatch):
    monkeypatch.setattr("dexnudge.perception.fusion.LARGEST_FIT", 160 * 120 // 4)
    found = fuse([camera((TABLE,), (0.5, 0, 0.4), (0, 0, 0))], LOW, HIGH, voxel=VOXEL)
    assert np.abs(distance(vertices_of(found, SEEN), TABLE)).max() < 0.02 * VOXEL


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"voxel": 0.0}, "`voxel` is 0.0 m; expected 0.0005 to 0.1"),
        ({"voxel": float("nan")}, "`voxel` is nan m; expected 0.0005 to 0.1"),
        ({"high": LOW}, "has no room; expected `low` below `high`"),
        ({"high": np.array([0.1, 0.1, np.inf])}, "has no room; expected `low` below `high`"),
        ({"low": LOW + 5, "high": HIGH + 5}, "none of the 5 views measures anything between"),
        ({"low": LOW - 5, "voxel": 0.001}, "make the box smaller, or `voxel` at least 0.01"),
    ],
)
def test_boxes_that_cannot_be_fused(views, changes, text):
    with pytest.raises(SceneError) as caught:
        fuse(views, **{"low": LOW, "high": HIGH, "voxel": VOXEL, **changes})
    assert text in str(caught.value)


def test_a_voxel_that_the_refusal_proposes_fits(views, monkeypatch):
    monkeypatch.setattr(fusion, "MAX_VOXELS", 10_000)
    with pytest.raises(SceneError, match=r"at least ([\d.]+) m") as caught:
        fuse(views, LOW, HIGH, voxel=VOXEL)
    assert isinstance(fuse(views, LOW, HIGH, voxel=float(str(caught.value).split()[-2])).mesh, trimesh.Trimesh)
