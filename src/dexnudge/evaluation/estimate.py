"""A number over objects with its interval."""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.evaluation.statistics import bootstrap_interval, bootstrap_sums


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
