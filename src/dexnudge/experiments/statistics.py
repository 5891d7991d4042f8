"""Estimates over objects, with bootstrap intervals."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError

RESAMPLES = 4000
"""Bootstrap samples: the ends of a 95 % interval then repeat to about a hundredth of its width."""
LEVEL = 0.95  # of the intervals

Statistic = Callable[[Float[np.ndarray, "resample column"]], Float[np.ndarray, " resample"]]


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval by bootstrap over objects; an end may be infinite."""

    value: float
    low: float
    high: float

    def percent(self) -> str:
        """Return a share as text, in percent: "97.8 (97-99)"."""
        return f"{100 * self.value:.1f} ({100 * self.low:.0f}-{100 * self.high:.0f})"

    def text(self, digits: int = 2) -> str:
        """Return the number as text: "0.21 (0.19-0.24)"; "0.21 (-)" where an end is infinite, so that it says nothing."""
        numbers = (round(number, digits) + 0.0 for number in (self.value, self.low, self.high))  # no "-0"
        value, low, high = (f"{number:.{digits}f}" for number in numbers)
        interval = f"{low}-{high}" if np.isfinite([self.low, self.high]).all() else "-"
        return f"{value} ({interval})" if np.isfinite(self.value) else "none"

    def inverse(self) -> "Estimate":
        """Return one over the number, which must not be negative; infinite where it is 0."""
        value, low, high = (1.0 / number if number else np.inf for number in (self.value, self.high, self.low))
        return Estimate(value, low, high)


def estimate_of_sums(columns: Float[np.ndarray, "object column"], statistic: Statistic, *, seed: int = 0) -> Estimate:
    """Return a statistic of the columns' sums over attempted objects, with its percentile bootstrap interval.

    Draws of one object are not independent, so whole objects are resampled. With one object, or equal values, the
    interval has no width: it then says nothing about unseen objects. The statistic may be infinite, but not NaN.

    Raises:
        InputError: no objects, or a value that is not finite.
    """
    if len(columns) == 0 or not np.isfinite(columns).all():
        raise InputError(f"an interval needs one finite value per object; got an array of shape {columns.shape[:1]}")
    # Sorted by hand: interpolating between an infinite value and a finite one would give NaN.
    found = np.sort(statistic(_times_drawn(len(columns), seed) @ columns))
    low, high = (_quantile(found, share) for share in ((1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0))
    return Estimate(float(statistic(columns.sum(axis=0)[None])[0]), low, high)


def mean_estimate(values: Sequence[float]) -> Estimate:
    """Return the mean over attempted objects, where a failed one counts as 0.

    Of shares of draws it is the share over all draws, as every object has the same number.
    """
    columns = np.stack([np.array(values, dtype=np.float64), np.ones(len(values))], axis=1)
    return estimate_of_sums(columns, ratio)


def quantile_estimate(values: Sequence[float], share: float) -> Estimate | None:
    """Return the least value that a share of the objects does not exceed, with its interval; None without any value."""
    if not values:
        return None
    ordered = np.sort(np.array(values, dtype=np.float64))

    def quantile(drawn: Float[np.ndarray, "resample object"]) -> Float[np.ndarray, " resample"]:
        reached = np.cumsum(drawn, axis=1) >= share * drawn.sum(axis=1, keepdims=True) - 1e-9
        return np.asarray(ordered[reached.argmax(axis=1)])

    found = np.sort(quantile(_times_drawn(len(ordered), 0)))
    low, high = (_quantile(found, level) for level in ((1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0))
    return Estimate(float(quantile(np.ones((1, len(ordered))))[0]), low, high)


def mean_of_known(values: Iterable[float | None]) -> Estimate | None:
    """Return the mean over the objects that have the number; None where none has."""
    known = [value for value in values if value is not None]
    return mean_estimate(known) if known else None


def ratio(sums: Float[np.ndarray, "resample 2"]) -> Float[np.ndarray, " resample"]:
    """Return the first over the second sum; infinite where the second is 0, and 0 where both are."""
    first, second = sums.T
    infinite = np.where(first > 0, np.inf, 0.0)
    return np.divide(first, second, out=infinite, where=second > 0)


def chance_of_top(good: Sequence[bool], k: int) -> float:
    """Return the chance that the best ranked of k draws, taken at random from all of them, is good.

    Sum over the good places i (0 the best) of C(n - 1 - i, k - 1) / C(n, k). Where good draws are ranked before all others
    this is pass@k (Chen et al., *Evaluating Large Language Models Trained on Code*, 2021, Eq. 1).

    Raises:
        InputError: k outside 1 to n.
    """
    num = len(good)
    if not 1 <= k <= num:
        raise InputError(f"cannot take {k} of {num} draws; expected 1 to {num}")
    return sum(math.comb(num - 1 - place, k - 1) for place, ok in enumerate(good) if ok) / math.comb(num, k)


def as_json(content: Any) -> Any:
    """Return `content`, however deep in dicts, lists and dataclasses, as JSON can hold it; null for an infinite number."""
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if is_dataclass(content) and not isinstance(content, type):
        return as_json(asdict(content))
    if isinstance(content, dict):
        return {str(key): as_json(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [as_json(value) for value in content]
    return content


@lru_cache(maxsize=4)  # a report asks for thousands of intervals over the same number of objects
def _times_drawn(objects: int, seed: int) -> Float[np.ndarray, "resample object"]:
    """How often each resample, of as many objects as there are, has drawn each of them."""
    draws = np.random.default_rng(seed).integers(0, objects, size=(RESAMPLES, objects))
    places = draws + objects * np.arange(RESAMPLES)[:, None]
    return np.bincount(places.reshape(-1), minlength=RESAMPLES * objects).reshape(RESAMPLES, objects).astype(np.float64)


def _quantile(ordered: Float[np.ndarray, " n"], share: float) -> float:
    place = share * (len(ordered) - 1)
    below, above = ordered[math.floor(place)], ordered[math.ceil(place)]
    return float(below if below == above else below + (place - math.floor(place)) * (above - below))
