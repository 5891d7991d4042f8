"""Two methods at equal time, against counts and times that are chosen."""

from dataclasses import replace

import pytest

from dexnudge.evaluation.equal_time import equal_time, equal_time_table


@pytest.fixture
def rows(made_up_rows):
    """Ours verifies 3, 1, 0 and none of the failed object, in 1.5 s each; the baseline 1, 1, 1 in 0.75, 3, 3 s."""
    a, b, c, failed = made_up_rows
    one = [True, False, False, False]

    def baseline(row, seconds):
        return replace(row, method="plain", success=one, seconds={"load": 1.0, "prepare": 0.5, "draw": seconds})

    return [a, baseline(a, 0.75), b, baseline(b, 3.0), c, baseline(c, 3.0), failed, replace(failed, method="plain")]


def test_the_baselines_count_is_scaled_to_the_same_time(rows):
    (found,) = equal_time(rows, "ours", "plain")
    assert (found.scene, found.method, found.baseline) == ("table", "ours", "plain")
    assert found.seconds.value == pytest.approx(1.5 * 3 / 4)
    assert found.verified.value == pytest.approx(4 / 4)
    assert found.baseline_verified.value == pytest.approx((1.5 / 0.75 + 1.5 / 3 + 1.5 / 3) / 4)


def test_rates_are_ratios_of_sums_and_loading_never_counts(rows):
    (found,) = equal_time(rows, "ours", "plain")
    ours, plain = 4 / (3 * 2.0), 3 / (1.25 + 3.5 + 3.5)
    assert found.per_second.value == pytest.approx(ours)
    assert found.baseline_per_second.value == pytest.approx(plain)
    assert found.speed_up.value == pytest.approx(ours / plain)
    assert found.prepared_speed_up.value == pytest.approx((4 / 4.5) / (3 / 6.75))
    assert found.speed_up.low <= found.speed_up.value <= found.speed_up.high


def test_a_baseline_that_verifies_nothing_is_infinitely_slower(rows):
    nothing = [replace(row, success=[False] * 4) if row.method == "plain" and row.success else row for row in rows]
    (found,) = equal_time(nothing, "ours", "plain")
    assert found.baseline_verified.value == 0.0
    assert found.speed_up.as_json()["value"] is None
    assert "| table | ours | plain |" in equal_time_table([found])


def test_every_scene_has_its_comparison(rows):
    assert len(equal_time([*rows, *(replace(row, scene="shelf") for row in rows)], "ours", "plain")) == 2
