"""Pieces against the mesh itself: they cover it, and do not reach far outside it; of sheets the surface is taken."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from dexnudge.errors import MeshError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import surface_points
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.families.shelf import cell
from dexnudge.simulation import convex_pieces, decomposition
from dexnudge.simulation.convex_pieces import (
    DECOMPOSE_OBJECT,
    TOLERANCE,
    bodies_of,
    decomposed,
    environment_pieces,
    object_pieces,
    simple_hull,
)
from dexnudge.simulation.surface_pieces import DEPTH

WAY = np.array([[0.3, 0.3, 0.0], [0.5, 0.4, 0.01]])


def test_a_convex_object_is_one_piece():
    mesh = builtin_object("box")
    (piece,) = object_pieces(mesh)
    assert ConvexHull(piece).volume == pytest.approx(mesh.volume, rel=0.01)


def test_pieces_cover_a_camera_phone_and_stay_close_to_it():
    mesh = builtin_object("phone-063")  # the hull of this one is half as large again
    pieces = object_pieces(mesh)
    assert len(pieces) > 1
    points = surface_points(mesh, spacing=0.004).points
    equations = [ConvexHull(piece).equations for piece in pieces]
    depth = np.min([(points @ e[:, :3].T + e[:, 3]).max(axis=1) for e in equations], axis=0)
    assert depth.max() < 2 * TOLERANCE
    distance = ExactDistance(mesh)
    outside = [distance(piece).distance.max() for piece in pieces]
    assert max(outside) < 2.0e-4
    assert sum(ConvexHull(piece).volume for piece in pieces) == pytest.approx(mesh.volume, rel=0.02)


def test_bodies_that_are_convex_are_taken_as_they_are():
    left, right = trimesh.creation.box((0.03, 0.02, 0.01)), trimesh.creation.box((0.02, 0.05, 0.01))
    right.apply_translation((0.03, 0.0, 0.0))
    both = trimesh.util.concatenate([left, right])
    assert len(bodies_of(both)) == 2
    volumes = sorted(ConvexHull(piece).volume for piece in object_pieces(both))
    assert volumes == pytest.approx([0.6e-5, 1.0e-5])


def test_simple_hull_leaves_out_at_most_the_tolerance():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.01)
    kept = simple_hull(np.asarray(ball.vertices), tolerance=2.0e-4)
    equations = ConvexHull(kept).equations
    assert (ball.vertices @ equations[:, :3].T + equations[:, 3]).max() <= 2.0e-4
    assert len(kept) < len(ball.vertices) / 10


def test_a_large_round_body_takes_few_hulls(monkeypatch):
    made = []
    monkeypatch.setattr(convex_pieces, "ConvexHull", lambda points: made.append(ConvexHull(points)) or made[-1])
    ball = np.asarray(trimesh.creation.icosphere(subdivisions=4, radius=0.1).vertices)
    kept = ConvexHull(simple_hull(ball, tolerance=2.0e-4))
    assert len(made) < convex_pieces.ONE_BY_ONE + 10 < len(kept.vertices)
    assert (ball @ kept.equations[:, :3].T + kept.equations[:, 3]).max() <= 2.0e-4 + 1e-12


def test_the_walls_of_a_shelf_are_five_boxes():
    mesh = cell(0.3, 0.2)
    pieces = environment_pieces(mesh, mesh.bounds)
    assert [len(piece) for piece in pieces] == [8] * 5
    assert sum(ConvexHull(piece).volume for piece in pieces) == pytest.approx(mesh.volume)


def test_a_part_that_is_not_convex_is_cut():
    outline = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.02], [0.02, 0.02], [0.02, 0.2], [0.0, 0.2]])
    angle = trimesh.creation.extrude_polygon(trimesh.path.polygons.Polygon(outline), 0.2)
    pieces = environment_pieces(angle, angle.bounds)
    assert len(pieces) >= 2
    assert sum(ConvexHull(piece).volume for piece in pieces) == pytest.approx(angle.volume, rel=0.03)


def test_of_a_sheet_beside_a_box_the_surface_is_taken():
    sheet = trimesh.Trimesh([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    slab = box((0.0, 0.0, -0.1), (1.0, 1.0, -0.05))
    first, second = environment_pieces(joined([slab, sheet]), WAY)
    np.testing.assert_allclose(np.sort(first, axis=0), np.sort(slab.vertices, axis=0))
    assert (second[:, 2].min(), second[:, 2].max()) == pytest.approx((-DEPTH, 0.0))


@pytest.mark.parametrize("busy", [1, 10_000], ids=["by the clock", "by what it computes"])
def test_what_takes_too_long_is_refused_with_what_to_do(busy, monkeypatch):
    monkeypatch.setattr(decomposition, "BUSY", busy)
    hollow = trimesh.creation.annulus(0.03, 0.05, 0.02, sections=64)
    with pytest.raises(MeshError) as raised:
        decomposed(hollow, DECOMPOSE_OBJECT, limit=0.05)
    assert str(raised.value) == (
        f"the object with {len(hollow.faces)} triangles was not cut into convex pieces within 0.05 s; expected a closed "
        "body of few triangles; close its holes, or decimate it to some thousands of triangles "
        "(in MeshLab: Simplification: Quadric Edge Collapse Decimation)"
    )
