"""Rates at other frictions and masses, from rows whose rates are known by hand."""

from dataclasses import replace

import pytest

from dexnudge.experiments.sweep_lines import sweep_lines, sweep_table


def swept(row, success):
    return replace(row, swept={"mass x 2": success})


def test_failed_objects_count_and_the_top_is_the_one_ranked_first_as_drawn(made_up_rows):
    a, b, c, failed = made_up_rows
    rows = [swept(a, [False, True, True, False]), swept(b, [True, False, False, False]), swept(c, [False] * 4), failed]
    drawn, heavy = sweep_lines(rows)
    assert (drawn.setting, heavy.setting) == ("as drawn", "mass x 2")
    assert (drawn.single.value, drawn.top.value, drawn.any.value) == pytest.approx((4 / 16, 2 / 4, 2 / 4))
    assert (heavy.single.value, heavy.top.value, heavy.any.value) == pytest.approx((3 / 16, 1 / 4, 2 / 4))
    assert "| table | dexnudge | mass × 2 | 18.8 (" in sweep_table([drawn, heavy])


def test_rows_without_a_sweep_have_no_lines(made_up_rows):
    assert sweep_lines(made_up_rows) == []
