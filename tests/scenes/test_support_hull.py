import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, QhullError

from dexnudge.scenes.support_hull import HULL_TOLERANCE, MAX_CORNERS, hull_corners, outer_points, reduce_supports

HALF_LENGTH = 0.08


def support(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Farthest extent of the points in each direction [m]."""
    return (points @ directions.T).max(axis=0)


@given(st.integers(0, 2**32 - 1), st.integers(1, 300))
def test_the_corners_span_what_all_points_span(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = rng.uniform(-0.08, 0.08, (count, 2)) @ frame[:2] + frame[2]
    kept = hull_corners(points, frame[2], tolerance=HULL_TOLERANCE * HALF_LENGTH)
    angle = np.linspace(0, 2 * np.pi, 180)
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ frame[:2]
    lost = support(points, directions) - support(points[kept], directions)
    assert lost.max() <= 2e-3 * HALF_LENGTH
    assert len(kept) <= MAX_CORNERS


def test_interior_points_and_points_on_sides_go() -> None:
    grid = np.stack(np.meshgrid(np.linspace(0, 0.1, 21), np.linspace(0, 0.05, 11)), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.zeros(len(grid))])
    kept, normals = reduce_supports(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), half_length=HALF_LENGTH)
    assert sorted(map(tuple, np.round(kept, 9))) == [(0, 0, 0), (0, 0.05, 0), (0.1, 0, 0), (0.1, 0.05, 0)]
    assert len(normals) == 4


@pytest.mark.parametrize("count", [40, 200])
def test_a_round_base_keeps_its_area(count: int) -> None:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    points = 0.08 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    kept = hull_corners(points, np.array([0.0, 0.0, 1.0]), tolerance=HULL_TOLERANCE * HALF_LENGTH)
    assert len(kept) <= MAX_CORNERS
    assert ConvexHull(points[kept, :2]).volume > 0.985 * ConvexHull(points[:, :2]).volume


def test_points_on_a_line_leave_its_ends_and_one_place_one_point() -> None:
    line = np.linspace(0, 1, 7)[:, None] * [0.1, 0.05, 0.0]
    assert sorted(hull_corners(line, np.array([0.0, 0.0, 1.0]), tolerance=1e-5)) == [0, 6]
    assert len(hull_corners(np.zeros((5, 3)), np.array([0.0, 0.0, 1.0]), tolerance=1e-5)) == 1


def test_planes_of_other_height_or_direction_are_kept_apart() -> None:
    square = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]])
    points = np.concatenate([square, square + np.array([0.01, 0.01, 0.05]), square[:, [2, 0, 1]]])
    normals = np.repeat([[0.0, 0, 1], [0, 0, 1], [1, 0, 0]], 4, axis=0)
    kept, kept_normals = reduce_supports(points, normals, half_length=HALF_LENGTH)
    assert len(kept) == 12
    assert sorted(map(tuple, kept_normals)) == sorted(map(tuple, normals))


def test_rough_ground_is_reduced_to_a_bounded_number() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.08, 0.08, (2000, 3)) * [1, 0.5, 0.005]
    normals = np.column_stack([rng.normal(0, 0.03, (2000, 2)), np.ones(2000)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    kept, kept_normals = reduce_supports(points, normals, half_length=HALF_LENGTH)
    assert 8 <= len(kept) <= 200
    places = {tuple(point): tuple(normal) for point, normal in zip(points, normals, strict=True)}
    assert all(places[tuple(p)] == tuple(n) for p, n in zip(kept, kept_normals, strict=True))


def test_nothing_stays_nothing() -> None:
    kept, normals = reduce_supports(np.zeros((0, 3)), np.zeros((0, 3)), half_length=HALF_LENGTH)
    assert len(kept) == len(normals) == 0


@given(st.integers(0, 2**32 - 1), st.integers(4, 300), st.booleans())
def test_no_corner_of_the_hull_is_among_the_points_left_out(seed, count, regular):
    points = np.random.default_rng(seed).normal(size=(count, 2))
    points = 0.002 * np.round(5 * points) if regular else 0.05 * points
    outer = outer_points(points)
    assert len(outer) < count or count < 60
    try:
        corners = ConvexHull(points).vertices
    except QhullError:
        return
    left = outer[ConvexHull(points[outer]).vertices]
    np.testing.assert_array_equal(points[left], points[corners])  # of points in one place, any is a corner


def test_of_points_in_one_place_all_are_outer_ones():
    np.testing.assert_array_equal(outer_points(np.ones((5, 2))), np.arange(5))
