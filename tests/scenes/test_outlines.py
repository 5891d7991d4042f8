"""Convex outlines against dense points and exact shapes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dexnudge.scenes.boxes import gap_between, outline_of, rectangle, swept


def edge_points(outline: np.ndarray, count: int = 150) -> np.ndarray:
    fractions = np.linspace(0, 1, count)[:, None, None]
    return (outline + fractions * (np.roll(outline, -1, axis=0) - outline)).reshape(-1, 2)


@settings(max_examples=25)
@given(st.integers(0, 2**16), st.floats(0.15, 0.4), st.floats(-np.pi, np.pi))
def test_the_gap_of_outlines_apart_is_that_of_their_nearest_points(seed, distance, yaw):
    generator = np.random.default_rng(seed)
    first = outline_of(generator.uniform(-0.05, 0.05, size=(12, 2)))
    second = rectangle(np.array([distance, 0.3 * distance]), (0.06, 0.03), yaw)
    nearest = np.linalg.norm(edge_points(first)[:, None] - edge_points(second)[None, ::2], axis=-1).min()
    assert gap_between(first, second) == pytest.approx(nearest, abs=2e-3)
    assert gap_between(first, second) <= nearest + 1e-12
    assert gap_between(second, first) == pytest.approx(gap_between(first, second))


def test_overlap_is_negative_and_as_deep_as_the_way_out():
    first, second = (rectangle(np.array([x, 0.0]), (0.2, 0.1), 0.0) for x in (0.0, 0.17))
    assert gap_between(first, second) == pytest.approx(-0.03)


def test_a_sweep_covers_start_and_end():
    square = rectangle(np.zeros(2), (0.1, 0.1), 0.0)
    moved = swept(square, np.array([0.3, 0.0]))
    np.testing.assert_allclose([moved.min(axis=0), moved.max(axis=0)], [[-0.05, -0.05], [0.35, 0.05]])
