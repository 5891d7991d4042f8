"""Figures of executions, found by hand."""

from dataclasses import replace

import numpy as np
import pytest

from dexnudge.experiments.disturbances import curves_of
from dexnudge.experiments.execution_trial import (
    GROUPS,
    MARGIN_BINS,
    WITH_ERRORS,
    ExecutionRecord,
    ExecutionTrial,
    margin_bin,
    rates_by,
)
from dexnudge.experiments.metrics import measure

CHANGED = {"mass x 0.5": True, "mass x 1.5": False}


def record(name, executed=(), *, scene="table", status="done"):
    return ExecutionRecord(
        object=name, scene=scene, method="steered_noise", status=status, seed=0, num=4, executed=list(executed)
    )


@pytest.fixture
def records(executed):
    return [
        record("a", [executed(0, 3.0, disturbed=CHANGED), executed(1, 2.7, "fell_short", links=1, reached=0.02)]),
        record("b", [executed(0, 1.6, "turned", behaviour="press", disturbed=CHANGED, reached=0.05), executed(1, 1.0)]),
        record("c", status="unverified"),
        record("d", status="failed"),
    ]


def test_what_was_attempted_is_the_denominator(records):
    (row,) = measure(records, ExecutionTrial.metrics)
    assert (row["objects"], row["failed"], row["unverified"], row["executed"]) == (4, 1, 1, 4)
    assert (row["top"].value, row["top"].low, row["top"].high) == (0.25, 0.0, 0.75)
    assert row["single"].value == pytest.approx(0.5)
    assert row["outcomes"] == {"fell short": 1, "turned": 1, "object failed": 1, "no draw verified": 1}
    assert [each.succeeded for each in records] == [True, False, False, False]


def test_a_push_that_began_with_another_draw_is_counted_once(executed):
    blocked = replace(executed(2, 1.2), began_with=0)
    elsewhere = replace(executed(3, 1.2, "turned"), began_with=7)
    records = [record("a", [replace(executed(0, 3.0), began_with=0), executed(1, 2.7, "turned"), blocked, elsewhere])]
    (row,) = measure(records, ExecutionTrial.metrics)
    assert row["executed"] == 3
    assert row["single"].value == pytest.approx(1 / 3)
    assert row["outcomes"] == {"turned": 2}
    assert {title: sum(group.number for group in rates_by(title, records)["all"].values()) for title in GROUPS} == {
        **dict.fromkeys(GROUPS, 3), WITH_ERRORS: 0
    }  # fmt: skip


def test_the_length_asked_and_reached_is_that_of_the_top_ranked(records):
    (row,) = measure(records, ExecutionTrial.metrics)
    assert row["length_asked_mm"].value == pytest.approx(100.0)
    assert row["length_reached_mm"].value == pytest.approx((90.0 + 50.0) / 2)
    (nothing,) = measure(records[2:], ExecutionTrial.metrics)
    assert nothing["length_reached_mm"] is nothing["single"] is None
    assert nothing["top"].value == 0.0


def test_margins_fall_into_their_bins():
    bins = MARGIN_BINS
    assert bins == sorted(bins) == ["1 to 1.25", "1.25 to 1.5", "1.5 to 2", "2 to 2.5", "2.5 to 3", "3 (cap)"]
    expected = {1.0: 0, 1.249: 0, 1.25: 1, 1.9: 2, 2.0: 3, 2.999: 4, 3.0: 5}
    assert {margin: bins.index(margin_bin(margin)) for margin in expected} == expected


def test_every_executed_draw_is_counted_once_in_its_group(records):
    found = rates_by("By force margin", records)
    assert list(found) == ["all", "table"]
    assert {label: (group.number, group.rate.value) for label, group in found["all"].items()} == {
        "1 to 1.25": (1, 1.0),
        "1.5 to 2": (1, 0.0),
        "2.5 to 3": (1, 0.0),
        "3 (cap)": (1, 1.0),
    }


def test_an_object_is_resampled_with_all_its_draws(records, executed, monkeypatch):
    """Of two objects with 1 of 2 successes each, every resample has the same rate; of (2 of 2, 0 of 2) it has not."""
    monkeypatch.setitem(GROUPS, "together", lambda each: [("all", each.success)])
    even = rates_by("together", records)["all"]["all"]
    assert (even.number, even.objects, even.rate.low, even.rate.high) == (4, 2, 0.5, 0.5)
    uneven = [record("a", [executed(0), executed(1)]), record("b", [executed(k, 2.0, "dropped") for k in (0, 1)])]
    rate = rates_by("together", uneven)["all"]["all"].rate
    assert (rate.value, rate.low, rate.high) == (0.5, 0.0, 1.0)


def test_errors_are_rated_over_what_was_played_with_them(records):
    rates = {
        name: (group.number, group.rate.value)
        for name, group in rates_by("With friction and mass errors", records)["all"].items()
    }
    assert rates == {"as drawn": (2, 0.5), "mass x 0.5": (2, 1.0), "mass x 1.5": (2, 0.0)}
    assert rates_by("With friction and mass errors", [record("c")])["all"] == {}


def test_success_is_drawn_over_each_factor_with_and_without_feedback(records):
    names = ["as drawn", "as drawn, open loop", "friction_hand x 0.5", "friction_hand x 0.5, open loop", "mass x 2"]
    curves = curves_of(dict(zip(names, range(5), strict=True)))
    assert curves["friction_hand"] == {"as executed": {1.0: 0, 0.5: 2}, "open loop": {1.0: 1, 0.5: 3}}
    assert curves["mass"] == {"as executed": {1.0: 0, 2.0: 4}, "open loop": {1.0: 1}}
    name, draw = next(each.chart for each in ExecutionTrial().sections(records) if each.title == WITH_ERRORS)
    panels = draw().axes
    assert name == "worlds.png"
    assert [axes.get_xlabel() for axes in panels] == [
        "friction hand, times planned", "friction environment, times planned", "mass, times planned"
    ]  # fmt: skip
    line = panels[2].lines[0]
    np.testing.assert_allclose(line.get_xdata(), [0.5, 1.0])
    np.testing.assert_allclose(line.get_ydata(), [100.0, 50.0])


def test_the_report_has_a_section_for_each_group(records):
    titles = [section.title for section in ExecutionTrial().sections(records)]
    assert titles == [
        "By force margin",
        "By behaviour",
        "By links in contact",
        "By approach",
        "With friction and mass errors",
    ]
    assert "| press | 0.0 (0-0), n = 1 |" in ExecutionTrial().sections(records)[1].table.markdown()
