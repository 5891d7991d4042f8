"""What a wall hides from the object counts as solid, and nothing else changes."""

import numpy as np
import pytest
import trimesh

from dexnudge.energies.environment_grids import OCCLUSION_CELL, occluded_grids
from dexnudge.geometry.distance_grid import distance_grid
from dexnudge.geometry.exact_distance import ExactDistance

WALL_AT, WALL_THICKNESS, REACH, CELL = 0.06, 0.002, 0.2, 0.01  # [m]


def place(mesh: trimesh.Trimesh, x: float) -> trimesh.Trimesh:
    mesh.apply_translation((x, 0.0, 0.0))
    return mesh


@pytest.fixture(scope="module")
def setting():
    """A small box at the origin beside a wall that is thin and far wider than the grid."""
    body = trimesh.creation.box((0.04, 0.02, 0.01))
    wall = place(trimesh.creation.box((WALL_THICKNESS, 2.0, 2.0)), WALL_AT)
    exact = ExactDistance(wall)
    plain = distance_grid(exact, np.full(3, -REACH), np.full(3, REACH), cell=CELL)
    x = plain.origin[0] + CELL * np.arange(plain.values.shape[0])
    return body, wall, exact, plain, x


def test_behind_a_thin_wall_it_is_as_deep_as_it_is_far_from_the_light(setting):
    body, wall, exact, plain, x = setting
    (occluded,) = occluded_grids([plain], body, wall, exact)
    behind = x > WALL_AT + WALL_THICKNESS / 2 + 2 * OCCLUSION_CELL
    assert (plain.values[behind] > 0).all(), "the signed distance alone knows nothing of the other side"
    assert (occluded.values[behind] < 0).all()
    depth = -occluded.values[behind]
    from_the_wall = (x[behind] - WALL_AT)[:, None, None]
    assert (depth <= from_the_wall + OCCLUSION_CELL).all()
    assert (depth >= from_the_wall - 2 * OCCLUSION_CELL).all()


def test_deeper_means_farther_behind(setting):
    body, wall, exact, plain, x = setting
    along = occluded_grids([plain], body, wall, exact)[0].values[x > WALL_AT + 2 * OCCLUSION_CELL, 20, 20]
    assert (np.diff(along) < 0).all()


def test_what_can_be_seen_stays_as_it_is(setting):
    body, wall, exact, plain, x = setting
    (occluded,) = occluded_grids([plain], body, wall, exact)
    visible = x < WALL_AT - WALL_THICKNESS / 2
    np.testing.assert_array_equal(occluded.values[visible], plain.values[visible])
    assert (occluded.values <= plain.values).all()
    assert (occluded.cell, occluded.values.shape) == (plain.cell, plain.values.shape)
    np.testing.assert_array_equal(occluded.origin, plain.origin)


def test_nothing_changes_where_all_is_visible(setting):
    body = setting[0]
    far = place(trimesh.creation.box((0.1, 0.1, 0.1)), 3.0)
    exact = ExactDistance(far)
    plain = distance_grid(exact, np.full(3, -REACH), np.full(3, REACH), cell=CELL)
    assert occluded_grids([plain], body, far, exact)[0] is plain


def test_nothing_changes_for_an_object_that_sees_nothing(setting):
    body, _, _, plain, _ = setting
    block = trimesh.creation.box((0.1, 0.1, 0.1))  # the object is buried in it
    assert occluded_grids([plain], body, block, ExactDistance(block))[0] is plain
