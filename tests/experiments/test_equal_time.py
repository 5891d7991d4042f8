"""Methods at equal time, against counts and times that are chosen."""

from dataclasses import replace

import pytest

from dexnudge.experiments.equal_time import equal_time, equal_time_table


@pytest.fixture
def rows(made_up_rows):
    """Ours verifies 3, 1, 0 and none of the failed object, in 1.5 s each; the baseline 1, 1, 1 in 0.75, 3, 3 s."""
    a, b, c, failed = made_up_rows
    one = [True, False, False, False]

    def baseline(row, seconds):
        spent = {"load": 1.0, "prepare": 0.5, "draw": seconds}
        return replace(row, method="plain", success=one, seconds=spent, joint_diversity=0.1, contact_diversity=seconds)

    a = replace(a, joint_diversity=0.2, contact_diversity=0.5)
    return [a, baseline(a, 0.75), b, baseline(b, 3.0), c, baseline(c, 3.0), failed, replace(failed, method="plain")]


def test_every_count_is_scaled_to_the_same_time(rows):
    ours, plain = equal_time(rows, "steered_noise", "plain")
    assert [(each.method, each.budget, each.baseline) for each in (ours, plain)] == [
        ("steered_noise", "steered_noise", "plain"),
        ("plain", "steered_noise", "plain"),
    ]
    for each in (ours, plain):
        assert each.scene == "table"
        assert each.seconds.value == pytest.approx(1.5 * 3 / 4)
    assert ours.verified.value == pytest.approx(4 / 4)
    assert plain.verified.value == pytest.approx((1.5 / 0.75 + 1.5 / 3 + 1.5 / 3) / 4)
    swapped = equal_time(rows, "plain", "steered_noise")[0]  # ours in the time of the baseline
    assert swapped.verified.value == pytest.approx((3 * 0.75 / 1.5 + 1 * 3.0 / 1.5) / 4)


def test_rates_are_ratios_of_sums_and_loading_never_counts(rows):
    found, itself = equal_time(rows, "steered_noise", "plain")
    ours, plain = 4 / (3 * 2.0), 3 / (1.25 + 3.5 + 3.5)
    assert found.per_second.value == pytest.approx(ours)
    assert itself.per_second.value == pytest.approx(plain)
    assert found.prepared_per_second.value == pytest.approx(4 / 4.5)
    assert found.speed_up.value == pytest.approx(ours / plain)
    assert found.prepared_speed_up.value == pytest.approx((4 / 4.5) / (3 / 6.75))
    assert found.speed_up.low <= found.speed_up.value <= found.speed_up.high
    assert (itself.speed_up.low, itself.speed_up.value, itself.speed_up.high) == pytest.approx((1.0, 1.0, 1.0))


def test_spreads_are_means_over_the_objects_that_have_one(rows):
    ours, plain = equal_time(rows, "steered_noise", "plain")
    assert (ours.joint_diversity.value, ours.contact_diversity.value) == (0.2, 0.5)  # of the first object alone
    assert plain.contact_diversity.value == pytest.approx((0.75 + 3.0 + 3.0) / 3)
    none = [replace(row, joint_diversity=None) for row in rows]
    assert equal_time(none, "steered_noise", "plain")[0].joint_diversity is None


def test_a_baseline_that_verifies_nothing_is_infinitely_slower(rows):
    nothing = [replace(row, success=[False] * 4) if row.method == "plain" and row.success else row for row in rows]
    found, itself = equal_time(nothing, "steered_noise", "plain")
    assert itself.verified.value == 0.0
    assert found.speed_up.as_json()["value"] is None
    assert "| table | dexnudge | 1.0 (" in equal_time_table([found])


def test_every_scene_has_its_comparison(rows):
    assert len(equal_time([*rows, *(replace(row, scene="shelf") for row in rows)], "steered_noise", "plain")) == 4
