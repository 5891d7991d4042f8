"""Intervals against scipy's bootstrap, and chances against every choice."""

from itertools import combinations

import numpy as np
import pytest
from scipy.stats import binom, bootstrap

from dexnudge.errors import InputError
from dexnudge.experiments.statistics import (
    Estimate,
    as_json,
    chance_of_top,
    estimate_of_sums,
    mean_estimate,
    mean_of_known,
    quantile_estimate,
    ratio,
)


def test_the_interval_is_scipys():
    values = np.random.default_rng(0).beta(2, 1, size=41)
    reference = bootstrap(
        (values,), np.mean, n_resamples=4000, method="percentile", random_state=np.random.default_rng(1)
    ).confidence_interval
    found = mean_estimate(values.tolist())
    assert found.value == pytest.approx(values.mean())
    assert (found.low, found.high) == pytest.approx(tuple(reference), abs=0.005)


def test_it_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(2)
    covered = 0
    for seed in range(100):
        columns = np.stack([rng.beta(2, 1, size=60), np.ones(60)], axis=1)
        found = estimate_of_sums(columns, ratio, seed=seed)
        covered += found.low <= 2 / 3 <= found.high
    assert 0.88 <= covered / 100 <= 1.0


def test_the_same_seed_gives_the_same_interval():
    columns = np.stack([np.linspace(0, 1, 17), np.ones(17)], axis=1)
    assert estimate_of_sums(columns, ratio, seed=3) == estimate_of_sums(columns, ratio, seed=3)
    assert estimate_of_sums(columns, ratio, seed=3) != estimate_of_sums(columns, ratio, seed=4)


def test_equal_values_have_no_width_and_unknown_ones_do_not_count():
    assert mean_estimate([1.0] * 5) == Estimate(1.0, 1.0, 1.0)
    assert mean_of_known([None, 2.0, None]) == Estimate(2.0, 2.0, 2.0)
    assert mean_of_known([None]) is None


def test_what_has_no_interval_is_refused():
    with pytest.raises(InputError, match=r"one finite value per object; got an array of shape \(0,\)"):
        mean_estimate([])
    with pytest.raises(InputError, match="one finite value per object"):
        mean_estimate([0.5, np.nan])


def test_the_interval_of_a_ratio_is_scipys():
    rng = np.random.default_rng(5)
    seconds = rng.uniform(1.0, 4.0, size=41)
    verified = np.round(seconds * rng.uniform(2.0, 6.0, size=41))
    reference = bootstrap(
        (verified, seconds),
        lambda v, s, axis: v.sum(axis=axis) / s.sum(axis=axis),
        paired=True,
        vectorized=True,
        n_resamples=4000,
        method="percentile",
        random_state=np.random.default_rng(1),
    ).confidence_interval
    found = estimate_of_sums(np.stack([verified, seconds], axis=1), ratio)
    assert (found.low, found.high) == pytest.approx(tuple(reference), abs=0.02)


def test_a_ratio_without_a_denominator_is_infinite_and_its_interval_is_no_nan():
    one_of_three = estimate_of_sums(np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 2.0]]), ratio)
    assert one_of_three.value == 1.5
    assert one_of_three.text().endswith(" (-)")
    assert one_of_three.high == np.inf  # (2/3)^3 of the resamples miss the third object
    assert one_of_three.low == pytest.approx(0.5)
    assert as_json({"rates": [one_of_three]}) == {"rates": [{"value": 1.5, "low": one_of_three.low, "high": None}]}
    nothing = estimate_of_sums(np.zeros((3, 2)), ratio)
    assert (nothing.value, nothing.low, nothing.high) == (0.0, 0.0, 0.0)
    assert nothing.inverse().text() == "none"
    assert Estimate(2.0, 1.0, 4.0).inverse() == Estimate(0.5, 0.25, 1.0)
    assert Estimate(0.978, 0.97, 0.99).percent() == "97.8 (97-99)"


@pytest.mark.parametrize("good", ["00000", "10000", "111000", "1111", "101101", "0010"])  # ranked, best first
def test_the_top_of_k_is_the_mean_over_every_choice_of_k(good):
    draws = [mark == "1" for mark in good]
    for k in range(1, len(draws) + 1):
        top = [draws[min(choice)] for choice in combinations(range(len(draws)), k)]
        assert chance_of_top(draws, k) == pytest.approx(sum(top) / len(top))


def test_more_draws_than_there_are_cannot_be_taken():
    with pytest.raises(InputError, match="cannot take 9 of 8 draws; expected 1 to 8"):
        chance_of_top([True] * 8, 9)


def test_a_quantile_is_a_value_that_was_measured_and_its_interval_that_of_resampled_objects():
    values = np.random.default_rng(0).exponential(size=200)
    found = quantile_estimate(values.tolist(), 0.5)
    ordered = np.sort(values)
    assert found.value == ordered[99]
    low, high = (ordered[int(binom.ppf(level, 200, 0.5))] for level in (0.025, 0.975))  # by order statistics
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.05)
    assert quantile_estimate([3.0, 1.0, 2.0, 10.0], 0.9).value == 10.0
    assert quantile_estimate([], 0.5) is None


def test_a_number_that_rounds_to_zero_has_no_sign():
    assert Estimate(-0.2, -1.2, 0.9).text(0) == "0 (-1-1)"
