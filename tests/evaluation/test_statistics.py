import numpy as np
import pytest
from scipy.stats import bootstrap

from dexnudge.errors import InputError
from dexnudge.evaluation.statistics import bootstrap_interval


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
