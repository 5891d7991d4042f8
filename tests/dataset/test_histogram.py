import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dexnudge.dataset.info import BINS, make_histogram, round_edges

values = st.lists(st.floats(-1e4, 1e4, width=32), min_size=1, max_size=30)


@given(values)
def test_every_value_is_counted_once(numbers):
    made = make_histogram("length", "mm", {"a": np.array(numbers), "none": np.zeros(0)})
    assert made.counts["a"].sum() == len(numbers)
    assert set(made.counts) == {"a"}
    assert len(made.edges) <= BINS + 3
    assert (np.diff(made.edges) > 0).all()


def test_counts_and_quantiles():
    made = make_histogram("length", "mm", {"a": np.array([0.0, 0.05, 0.31, 1.2]), "b": np.array([0.55])})
    np.testing.assert_allclose(made.edges, np.arange(13) * 0.1)
    assert made.counts["a"].tolist() == [2, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1]
    assert made.counts["b"].tolist() == [0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]
    assert made.quantiles["a"][[0, 2, 4]] == pytest.approx([0.0, 0.18, 1.2])
    assert made.title == "length [mm]"


def test_a_single_value_gets_one_bin():
    edges = round_edges(np.array([3.0, 3.0]))
    assert edges[0] <= 3.0 <= edges[-1]
    assert len(edges) == 2
