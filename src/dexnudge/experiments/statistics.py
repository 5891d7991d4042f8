"""A number over objects with its interval."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError

RESAMPLES = 4000
"""Bootstrap samples: the ends of a 95 % interval then repeat to about a hundredth of its width."""


def bootstrap_interval(
    values: Float[np.ndarray, " object"], *, level: float = 0.95, seed: int = 0, resamples: int = RESAMPLES
) -> tuple[float, float]:
    """Return the percentile bootstrap interval of the mean over objects.

    values: one number per attempted object, a failed one included as 0: the share of its draws that succeed (rate over
    all samples), or 0/1 for its top-ranked draw or for any of its n. Draws of one object are not independent, so whole
    objects are resampled. With one object, or equal values, the interval has no width: it then says nothing about
    unseen objects.

    Raises:
        InputError: no values, a value that is not finite, or a level outside (0, 1).
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1:
        raise InputError(f"an interval needs one finite value per object; got an array of shape {values.shape}")
    return bootstrap_sums(values[:, None], lambda sums: sums[:, 0] / len(values), level, seed, resamples)


def bootstrap_sums(
    columns: Float[np.ndarray, "object column"],
    statistic: Callable[[Float[np.ndarray, "resample column"]], Float[np.ndarray, " resample"]],
    level: float = 0.95,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> tuple[float, float]:
    """Return the percentile bootstrap interval of a statistic of sums over objects, such as a ratio of two of them.

    columns: several numbers per attempted object, resampled together. statistic: of the columns' sums over the objects,
    for many resamples at once; may be infinite, but not NaN.

    Raises:
        InputError: no objects, a value that is not finite, or a level outside (0, 1).
    """
    if len(columns) == 0 or not np.isfinite(columns).all():
        raise InputError(f"an interval needs one finite value per object; got an array of shape {columns.shape[:1]}")
    if not 0.0 < level < 1.0:
        raise InputError(f"the level of an interval is {level}; expected a number between 0 and 1, such as 0.95")
    # Sorted by hand: interpolating between an infinite value and a finite one would give NaN.
    found = np.sort(statistic(_times_drawn(len(columns), seed, resamples) @ columns))
    low, high = (_quantile(found, share) for share in ((1.0 - level) / 2.0, (1.0 + level) / 2.0))
    return low, high


def chance_of_top(good: Sequence[bool], k: int) -> float:
    """Return the chance that the best ranked of k draws, taken at random from all of them, is good.

    Sum over the good places i (0 the best) of C(n - 1 - i, k - 1) / C(n, k): the draw there is the best ranked of the k
    where the other k - 1 are all ranked below it. Without bias from more than k draws. Where good draws are ranked before
    all others this is the chance that any of the k is good (Chen et al., *Evaluating Large Language Models Trained on
    Code*, 2021, Eq. 1).

    Raises:
        InputError: k outside 1 to n.
    """
    num = len(good)
    if not 1 <= k <= num:
        raise InputError(f"cannot take {k} of {num} draws; expected 1 to {num}")
    return sum(math.comb(num - 1 - place, k - 1) for place, ok in enumerate(good) if ok) / math.comb(num, k)


@lru_cache(maxsize=4)  # a report asks for thousands of intervals over the same number of objects
def _times_drawn(objects: int, seed: int, resamples: int) -> Float[np.ndarray, "resample object"]:
    """How often each resample, of as many objects as there are, has drawn each of them."""
    draws = np.random.default_rng(seed).integers(0, objects, size=(resamples, objects))
    places = draws + objects * np.arange(resamples)[:, None]
    counts = np.bincount(places.reshape(-1), minlength=resamples * objects)
    return counts.reshape(resamples, objects).astype(np.float64)


def _quantile(ordered: Float[np.ndarray, " n"], share: float) -> float:
    place = share * (len(ordered) - 1)
    below, above = ordered[math.floor(place)], ordered[math.ceil(place)]
    return float(below if below == above else below + (place - math.floor(place)) * (above - below))


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval by bootstrap over objects; an end may be infinite."""

    value: float
    low: float
    high: float

    def percent(self) -> str:
        """A share as text, in percent: "97.8 (97-99)"."""
        return f"{100 * self.value:.1f} ({100 * self.low:.0f}-{100 * self.high:.0f})"

    def text(self, digits: int = 2) -> str:
        """The number itself: "0.21 (0.19-0.24)"."""
        value, low, high = (f"{number:.{digits}f}" for number in (self.value, self.low, self.high))
        return f"{value} ({low}-{high})" if np.isfinite(self.value) else "none"

    def inverse(self) -> "Estimate":
        """Of one over the number, which must not be negative; infinite where it is 0."""
        value, low, high = (1.0 / number if number else np.inf for number in (self.value, self.high, self.low))
        return Estimate(value, low, high)

    def as_json(self) -> dict[str, float | None]:
        """Its fields; null where a number is infinite, which JSON does not have."""
        return {key: number if np.isfinite(number) else None for key, number in asdict(self).items()}


def mean_estimate(values: list[float]) -> Estimate:
    """Mean over objects; of shares of draws it is the share over all draws, as every object has the same number."""
    array: Float[np.ndarray, " n"] = np.array(values, dtype=np.float64)
    return Estimate(float(array.mean()), *bootstrap_interval(array))


def mean_of_known(values: Iterable[float | None]) -> Estimate | None:
    """Mean over the objects that have the number; None where none has."""
    known = [value for value in values if value is not None]
    return mean_estimate(known) if known else None


def estimate_of_sums(
    columns: Float[np.ndarray, "object column"],
    statistic: Callable[[Float[np.ndarray, "resample column"]], Float[np.ndarray, " resample"]],
) -> Estimate:
    """A statistic of sums over objects, see `bootstrap_sums`."""
    return Estimate(float(statistic(columns.sum(axis=0)[None])[0]), *bootstrap_sums(columns, statistic))


def ratio(sums: Float[np.ndarray, "resample 2"]) -> Float[np.ndarray, " resample"]:
    """First over second sum; infinite where the second is 0, and 0 where both are."""
    first, second = sums.T
    infinite = np.where(first > 0, np.inf, 0.0)
    return np.divide(first, second, out=infinite, where=second > 0)


def as_json(content: Any) -> Any:
    """`content` with every estimate, however deep in dicts and lists, as JSON can hold it."""
    if isinstance(content, Estimate):
        return content.as_json()
    if isinstance(content, dict):
        return {str(key): as_json(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [as_json(value) for value in content]
    return content
