"""Counts of a quantity in bins of a round width, and its quantiles."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

BINS = 12  # about as many as a person takes in at a glance
ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)  # times a power of ten: widths that read well
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


@dataclass(frozen=True, kw_only=True)
class Histogram:
    """How often a quantity falls into each bin [edge k, edge k + 1); the last bin holds its upper edge too.

    counts: label of a group of rows -> rows per bin; quantiles: the same labels -> values at `QUANTILES`.
    """

    quantity: str
    unit: str
    edges: Float[np.ndarray, " edge"]
    counts: dict[str, Int[np.ndarray, " bin"]]
    quantiles: dict[str, Float[np.ndarray, " quantile"]]

    @property
    def title(self) -> str:
        """The quantity with its unit."""
        return f"{self.quantity} [{self.unit}]" if self.unit else self.quantity


def make_histogram(quantity: str, unit: str, values: dict[str, Float[np.ndarray, " n"]]) -> Histogram:
    """The histogram of finite values by group; groups without values are left out."""
    groups = {label: np.asarray(group, dtype=np.float64) for label, group in values.items() if len(group)}
    edges = round_edges(np.concatenate(list(groups.values()) or [np.zeros(1)]))
    return Histogram(
        quantity=quantity,
        unit=unit,
        edges=edges,
        counts={label: np.histogram(group, edges)[0] for label, group in groups.items()},
        quantiles={label: np.quantile(group, QUANTILES) for label, group in groups.items()},
    )


def round_edges(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " edge"]:
    """Edges at multiples of a round width that enclose all values in at most about `BINS` bins."""
    low, high = float(values.min()), float(values.max())
    wanted = max((high - low) / BINS, 1e-12 * max(abs(low), abs(high), 1.0))
    power = 10.0 ** np.floor(np.log10(wanted))
    width = power * min(factor for factor in ROUND if factor * power >= wanted * (1 - 1e-9))
    first, last = np.floor(low / width), np.ceil(high / width)
    # Products like 3 * 0.1 may fall a hair inside the outermost value.
    edges = np.arange(first, max(last, first + 1) + 1) * width
    edges[0], edges[-1] = min(edges[0], low), max(edges[-1], high)
    return edges
