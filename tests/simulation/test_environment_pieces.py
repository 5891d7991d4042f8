"""Surroundings as convex bodies: boxes stay what they are, others are cut, sheets are refused."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from dexnudge.errors import MeshError
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.shelf import cell
from dexnudge.simulation.environment_pieces import environment_pieces


def test_the_walls_of_a_shelf_are_five_boxes():
    mesh = cell(0.3, 0.2)
    pieces = environment_pieces(mesh)
    assert [len(piece) for piece in pieces] == [8] * 5
    assert sum(ConvexHull(piece).volume for piece in pieces) == pytest.approx(mesh.volume)


def test_a_part_that_is_not_convex_is_cut():
    outline = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.02], [0.02, 0.02], [0.02, 0.2], [0.0, 0.2]])
    angle = trimesh.creation.extrude_polygon(trimesh.path.polygons.Polygon(outline), 0.2)
    pieces = environment_pieces(angle)
    assert len(pieces) >= 2
    assert sum(ConvexHull(piece).volume for piece in pieces) == pytest.approx(angle.volume, rel=0.03)


def test_a_sheet_is_refused_by_name():
    sheet = trimesh.Trimesh([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(MeshError) as raised:
        environment_pieces(joined([box((0.0, 0.0, -0.1), (1.0, 1.0, -0.05)), sheet]))
    assert str(raised.value) == (
        "part 2 of 2 of the environment (2 triangles around (0.500, 0.500, 0.000)) is a flat sheet; MuJoCo's contacts "
        "expect bodies with a thickness; make a box of it, or leave it out"
    )
