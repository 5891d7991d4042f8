"""The grid carried along a turn against exact distances at many poses, one by one."""

import numpy as np
import pytest
import trimesh

from dexnudge.energies.environment_grids import carried_grid
from dexnudge.energies.kernel_inputs import swept_grid
from dexnudge.geometry.distance_grid import distance_grid, grid_corners
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.scenes.motion import Motion, Turn

CELL, COARSE = 0.005, 0.01  # [m]
FORWARD, UP, SIDEWAYS = np.eye(3)[0], np.eye(3)[2], np.eye(3)[1]


@pytest.fixture(scope="module")
def clutter():
    """A block and a post at odd places."""
    one = trimesh.creation.box((0.03, 0.05, 0.04)).apply_translation((0.09, 0.01, 0.0))
    other = trimesh.creation.cylinder(0.01, 0.1).apply_translation((-0.06, -0.02, 0.02))
    return ExactDistance(trimesh.util.concatenate([one, other]))


def grids(clutter):
    near, far = (
        distance_grid(clutter, np.full(3, -half), np.full(3, half), cell=cell)
        for half, cell in ((0.05, CELL), (0.15, COARSE))
    )
    return near, far


def turning(angle: float, axis: np.ndarray, slide: float) -> Motion:
    return Motion(Turn(angle, axis, np.array([0.01, 0.02, -0.03])), FORWARD, slide, 0.06)


@pytest.mark.parametrize(
    "motion", [turning(np.pi / 2, UP, 0.0), turning(0.5, UP, 0.05), turning(0.6, SIDEWAYS, 0.0)], ids=str
)
def test_it_is_the_least_exact_distance_on_the_way(clutter, motion):
    near, far = grids(clutter)
    found = carried_grid(near, motion, around=far)
    points = grid_corners(near).reshape(-1, 3)
    exact = np.full(len(points), np.inf)
    for way in np.linspace(0.0, motion.length, 120):
        T = motion.displacement(way)
        exact = np.minimum(exact, clutter(points @ T[:3, :3].T + T[:3, 3]).distance)
    expected = exact.reshape(near.values.shape)
    assert (expected < near.values - 0.02).mean() > 0.1, "otherwise there is nothing in the way"
    error = found.values - expected
    assert np.abs(error).max() < COARSE
    assert np.abs(error).mean() < 0.1 * CELL
    assert (found.values <= near.values).all()


def test_a_slide_is_swept_alike(clutter):
    near, far = grids(clutter)
    straight = carried_grid(near, Motion(None, FORWARD, 0.06), around=far)
    np.testing.assert_allclose(straight.values, swept_grid(near, 0.06 * FORWARD, around=far).values, atol=1e-6)


def test_a_thin_post_far_from_the_axis_is_not_skipped():
    """At 14 cm from the axis the corners move far between coarse poses; the post is thinner than a cell's diagonal."""
    post = ExactDistance(trimesh.creation.cylinder(0.004, 0.2).apply_translation((0.0, 0.14, 0.0)))
    grid = distance_grid(post, np.full(3, -0.15), np.full(3, 0.15), cell=COARSE)
    found = carried_grid(grid, Motion(Turn(np.pi, UP, np.zeros(3)), FORWARD, 0.0, 0.02))
    corners = grid_corners(grid)
    ring = (np.abs(np.linalg.norm(corners[..., :2], axis=-1) - 0.14) < 0.002) & (corners[..., 1] < -0.02)
    ring &= (corners[..., 0] > 0.03) & (np.abs(corners[..., 2]) < 0.05)
    assert ring.any()
    assert found.values[ring].max() < COARSE


def test_a_table_under_a_turn_changes_nothing():
    table = ExactDistance(trimesh.creation.box((4.0, 4.0, 0.02)))
    grid = distance_grid(table, np.full(3, -0.1), np.full(3, 0.1), cell=COARSE)
    np.testing.assert_allclose(carried_grid(grid, turning(1.0, UP, 0.05)).values, grid.values, atol=1e-5)


@pytest.mark.parametrize("turn", [0.6, np.pi])
def test_only_distances_beyond_what_is_relevant_may_be_too_large(clutter, turn):
    near, far = grids(clutter)
    motion = turning(turn, UP, 0.05)
    whole = carried_grid(near, motion, around=far).values
    found = carried_grid(near, motion, around=far, relevant=0.02).values
    larger = found != whole
    assert (whole[larger] > 0.02 - 2 * near.cell).all()
    assert (found >= whole).all()
    np.testing.assert_array_equal(found[whole < 0.02 - 2 * near.cell], whole[whole < 0.02 - 2 * near.cell])
