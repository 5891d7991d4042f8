from itertools import combinations

import numpy as np
import pytest
from scipy.stats import bootstrap

from dexnudge.errors import InputError
from dexnudge.experiments.statistics import (
    Estimate,
    bootstrap_interval,
    bootstrap_sums,
    chance_of_top,
    estimate_of_sums,
    ratio,
)


def test_the_interval_is_scipys() -> None:
    values = np.random.default_rng(0).beta(2, 1, size=41)
    reference = bootstrap(
        (values,), np.mean, n_resamples=4000, method="percentile", random_state=np.random.default_rng(1)
    ).confidence_interval
    assert bootstrap_interval(values) == pytest.approx(tuple(reference), abs=0.005)


def test_it_covers_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(2)
    covered = 0
    for seed in range(300):
        low, high = bootstrap_interval(rng.beta(2, 1, size=60), seed=seed, resamples=500)
        covered += low <= 2 / 3 <= high
    assert 0.90 <= covered / 300 <= 0.98


def test_the_same_seed_gives_the_same_interval() -> None:
    values = np.linspace(0, 1, 17)
    assert bootstrap_interval(values, seed=3) == bootstrap_interval(values, seed=3)
    assert bootstrap_interval(values, seed=3) != bootstrap_interval(values, seed=4)


def test_equal_values_have_no_width() -> None:
    assert bootstrap_interval(np.ones(5)) == (1.0, 1.0)


def test_what_has_no_interval_is_refused() -> None:
    with pytest.raises(InputError, match=r"one finite value per object; got an array of shape \(0,\)"):
        bootstrap_interval(np.zeros(0))
    with pytest.raises(InputError, match="one finite value per object"):
        bootstrap_interval(np.array([0.5, np.nan]))
    with pytest.raises(InputError, match=r"level of an interval is 95\.0; expected a number between 0 and 1"):
        bootstrap_interval(np.ones(3), level=95.0)


def test_the_interval_of_a_ratio_is_scipys() -> None:
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
    assert bootstrap_sums(np.stack([verified, seconds], axis=1), ratio) == pytest.approx(tuple(reference), abs=0.02)


def test_a_ratio_without_a_denominator_is_infinite_and_its_interval_is_no_nan() -> None:
    one_of_three = estimate_of_sums(np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 2.0]]), ratio)
    assert one_of_three.value == 1.5
    assert one_of_three.high == np.inf  # (2/3)^3 of the resamples miss the third object
    assert one_of_three.low == pytest.approx(0.5)
    assert one_of_three.as_json() == {"value": 1.5, "low": one_of_three.low, "high": None}
    nothing = estimate_of_sums(np.zeros((3, 2)), ratio)
    assert (nothing.value, nothing.low, nothing.high) == (0.0, 0.0, 0.0)
    assert nothing.inverse().text() == "none"
    assert Estimate(2.0, 1.0, 4.0).inverse() == Estimate(0.5, 0.25, 1.0)


@pytest.mark.parametrize("good", ["00000", "10000", "111000", "1111", "101101", "0010"])  # ranked, best first
def test_the_top_of_k_is_the_mean_over_every_choice_of_k(good: str) -> None:
    draws = [mark == "1" for mark in good]
    for k in range(1, len(draws) + 1):
        top = [draws[min(choice)] for choice in combinations(range(len(draws)), k)]
        assert chance_of_top(draws, k) == pytest.approx(sum(top) / len(top))


def test_where_good_draws_come_first_the_top_is_good_if_any_is() -> None:
    draws = [True] * 3 + [False] * 5
    found = [any(choice) for choice in combinations(draws, 4)]
    assert chance_of_top(draws, 4) == pytest.approx(sum(found) / len(found))


def test_more_draws_than_there_are_cannot_be_taken() -> None:
    with pytest.raises(InputError, match="cannot take 9 of 8 draws; expected 1 to 8"):
        chance_of_top([True] * 8, 9)
