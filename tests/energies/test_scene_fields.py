"""The swept grid against exact distances at many places along the way, and its two easy cases."""

import numpy as np
import pytest
import trimesh

from dexnudge.energies.kernel_inputs import swept_grid
from dexnudge.geometry.distance_grid import distance_grid
from dexnudge.geometry.exact_distance import ExactDistance

CELL, COARSE = 0.005, 0.01  # [m]
LENGTH = 0.06  # [m] twelve cells, six coarse ones


@pytest.fixture(scope="module")
def clutter():
    """Two blocks at odd places and angles."""
    one = trimesh.creation.box((0.03, 0.05, 0.04)).apply_translation((0.09, 0.01, 0.0))
    other = trimesh.creation.cylinder(0.01, 0.1).apply_translation((-0.06, -0.02, 0.02))
    return ExactDistance(trimesh.util.concatenate([one, other]))


def corners(grid):
    axes = [grid.origin[k] + grid.cell * np.arange(grid.values.shape[k]) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, -1, 0)])
def test_it_is_the_least_exact_distance_along_the_way(clutter, direction):
    """Beyond the grid, where the coarse one steps in, to its interpolation."""
    near = distance_grid(clutter, np.full(3, -0.05), np.full(3, 0.05), cell=CELL)
    far = distance_grid(clutter, np.full(3, -0.15), np.full(3, 0.15), cell=COARSE)
    way = LENGTH * np.asarray(direction, dtype=float)
    swept = swept_grid(near, way, around=far)
    points = corners(near).reshape(-1, 3)
    steps = np.linspace(0.0, 1.0, 13)
    expected = np.min([clutter(points + s * way).distance for s in steps], axis=0).reshape(near.values.shape)
    assert (expected < near.values - 0.01).any(), "otherwise there is nothing in the way"
    error = swept.values - expected
    assert np.abs(error).max() < 0.5 * COARSE
    half = swept_grid(near, 0.25 * way, around=far).values  # a quarter of the way, which stays in half of the grid
    inside = (np.abs(points + 0.25 * way) <= 0.05).all(axis=1).reshape(near.values.shape)
    exact = np.min([clutter(points + s * way).distance for s in steps[:4]], axis=0).reshape(near.values.shape)
    np.testing.assert_allclose(half[inside], exact[inside], atol=1e-6)


def test_a_surface_along_the_way_changes_nothing():
    table = ExactDistance(trimesh.creation.box((4.0, 4.0, 0.02)))
    grid = distance_grid(table, np.full(3, -0.1), np.full(3, 0.1), cell=COARSE)
    np.testing.assert_allclose(swept_grid(grid, np.array([0.1, 0.0, 0.0])).values, grid.values, atol=1e-5)


def test_without_a_larger_grid_the_way_ends_at_the_edge(clutter):
    grid = distance_grid(clutter, np.full(3, -0.05), np.full(3, 0.05), cell=CELL)
    swept = swept_grid(grid, np.array([0.2, 0.0, 0.0]))
    expected = np.minimum.accumulate(grid.values[::-1], axis=0)[::-1]
    np.testing.assert_array_equal(swept.values, expected)
    np.testing.assert_array_equal(swept.origin, grid.origin)


def test_no_way_no_change(clutter):
    grid = distance_grid(clutter, np.full(3, -0.05), np.full(3, 0.05), cell=CELL)
    assert swept_grid(grid, np.zeros(3)) is grid
