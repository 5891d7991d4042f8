"""Outlines of many corners: the same as by the plain search, in memory that does not grow with the square."""

import tracemalloc

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from dexnudge.scenes.resting import long_side_along_x
from dexnudge.scenes.support_hull import MAX_CORNERS, hull_corners


def plainly(flat: np.ndarray, tolerance: float) -> set[int]:
    """Corners without the flattest, found anew each time."""
    corners = ConvexHull(flat).vertices.tolist()
    while len(corners) > 3:
        here, before, after = (np.roll(flat[corners], step, axis=0) for step in (0, 1, -1))
        chord, arm = after - before, here - before
        area = np.abs(chord[:, 0] * arm[:, 1] - chord[:, 1] * arm[:, 0])
        height = area / np.linalg.norm(chord, axis=1)
        if height.min() > tolerance and len(corners) <= MAX_CORNERS:
            break
        del corners[int(np.argmin(height))]
    return set(corners)


def ellipse(count: int) -> np.ndarray:
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False) + 0.1
    return np.stack([0.07 * np.cos(angle), 0.03 * np.sin(angle)], axis=1)


@pytest.mark.parametrize("shape", ["cloud", "ellipse", "raster", "two lines"])
@pytest.mark.parametrize("tolerance", [0.0, 5e-5, 5e-3])
def test_the_flattest_corners_are_dropped_one_after_another(shape, tolerance):
    generator = np.random.default_rng(0)
    flat = {
        "cloud": generator.normal(0.0, 0.05, (300, 2)),
        "ellipse": ellipse(400),
        "raster": 0.01 * generator.integers(0, 9, (100, 2)),
        "two lines": np.stack([generator.uniform(-0.07, 0.07, 90), generator.choice([-0.03, 0.03], 90)], axis=1),
    }[shape]
    points = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
    found = hull_corners(points, np.array([0.0, 0.0, 1.0]), tolerance=tolerance)
    places = {tuple(np.round(flat[corner], 12)) for corner in found}
    assert places == {tuple(np.round(flat[corner], 12)) for corner in plainly(flat, tolerance)}


def test_a_rim_of_20_000_corners_takes_little_memory():
    tracemalloc.start()
    rotation = long_side_along_x(ellipse(20_000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 300e6
    np.testing.assert_allclose(np.abs(rotation[0, 0]), 1.0, atol=1e-4)  # the ellipse's long side lies along x
