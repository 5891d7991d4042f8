"""Distinct rows are those of NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dexnudge.geometry.surface_lattice import distinct_rows


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 60),
    st.integers(1, 6),
    st.sampled_from([np.int64, np.float64]),
    st.sampled_from([1, 10**7, 2**60, 0.5]),  # as one number, too large for one, fractions
)
def test_equals_numpys_unique_rows(seed, count, columns, kind, scale):
    rows = np.random.default_rng(seed).integers(-1, 2, (count, columns))
    rows = (rows * scale).astype(np.float64 if scale == 0.5 else kind)
    rows = -rows if rows.dtype == np.float64 else rows  # zeros of either sign are equal
    first, place = distinct_rows(rows)
    _, expected_first, expected_place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(first, expected_first)
    np.testing.assert_array_equal(place, expected_place.reshape(-1))


@pytest.mark.parametrize("columns", [1, 3])
def test_no_rows_are_no_distinct_ones(columns):
    first, place = distinct_rows(np.zeros((0, columns)))
    assert (len(first), len(place)) == (0, 0)
