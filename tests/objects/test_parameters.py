"""Proportions of the built-in objects and the wall between training and test."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dexnudge.objects.builtin import CELLS, KINDS, draw_size, is_test_cell

from .cells import cell_of


def test_both_sets_have_cells_in_every_row_and_column_range():
    test = {(c, r) for c in range(CELLS) for r in range(CELLS) if is_test_cell(c, r)}
    assert 5 <= len(test) <= 9
    assert {r for _, r in test} == set(range(CELLS))
    assert len({c for c, _ in test}) >= 5


@settings(max_examples=60)
@given(st.sampled_from(sorted(KINDS)), st.integers(0, 2**32), st.booleans())
def test_a_drawn_size_lies_in_a_cell_of_its_set_and_in_range(kind, seed, test):
    length, width, thickness = draw_size(kind, np.random.default_rng(seed), test=test)
    assert is_test_cell(*cell_of(kind, (length, width, thickness))) == test
    assert 0.09 <= length <= 0.25
    assert 0.14 <= width / length <= 0.75
    assert 0.04 <= thickness / length <= 0.25
    assert thickness <= 0.8 * width * (1 + 1e-12)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_training_and_test_proportions_keep_a_distance(kind):
    def corners(*, test: bool) -> np.ndarray:
        sizes = [draw_size(kind, np.random.default_rng(seed), test=test) for seed in range(150)]
        cells = []
        for length, width, thickness in sizes:
            low, high = KINDS[kind].thickness_ratio
            high = min(high, 0.8 * width / length)
            span = KINDS[kind].width_ratio
            cells.append(
                [
                    (width / length - span[0]) / (span[1] - span[0]) * CELLS,
                    (thickness / length - low) / (high - low) * CELLS,
                ]
            )
        return np.array(cells)

    train, test = corners(test=False), corners(test=True)
    gap = np.abs(train[:, None] - test[None]).max(axis=-1).min()
    assert gap >= 0.2 - 1e-9  # a tenth of a cell on both sides of each wall
