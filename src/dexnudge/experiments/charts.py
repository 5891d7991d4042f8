"""Charts of experiments, drawn by matplotlib (extra `plots`); reports go without them where it is not installed."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dexnudge.errors import OutputError
from dexnudge.experiments.metrics import GroupRate
from dexnudge.experiments.statistics import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AVAILABLE = find_spec("matplotlib") is not None
MISSING = "Charts need matplotlib: `pip install 'dexnudge[plots]'`."
WIDTH = 8.0  # [inch]
ROW = 0.3  # [inch] of height for each bar
DPI = 120
INK = "#222222"


def interval_chart(
    title: str, groups: Mapping[str, Mapping[str, Estimate]], *, label: str, share: bool = False
) -> "Figure":
    """Return a figure with one bar for each name in each group, and its 95 % interval as a line.

    share: whether values are shares, drawn in percent from 0 to 100. Infinite values and ends are cut.
    """
    rows = [(group, name, estimate) for group, bars in groups.items() for name, estimate in bars.items()]
    factor = 100.0 if share else 1.0
    figure, axes = _axes(title, height=1.2 + ROW * (len(rows) + len(groups)))
    ends = [factor * end for _, _, e in rows for end in (e.value, e.high) if np.isfinite(end)]
    limit = 100.0 if share else 1.05 * max(ends, default=1.0) or 1.0
    place, ticks, colours = 0.0, [], dict(zip(groups, _colours(len(groups)), strict=True))
    for number, (group, name, estimate) in enumerate(rows):
        if number == 0 or rows[number - 1][0] != group:
            place += 1.0
            axes.text(0.0, place - 0.8, group, weight="bold", va="center", color=INK)
        value, low, high = (min(factor * x, limit) for x in (estimate.value, estimate.low, estimate.high))
        axes.barh(place, value, height=0.7, color=colours[group], alpha=0.75)
        axes.plot([low, high], [place, place], color=INK, linewidth=1.5)
        text = estimate.percent() if share else estimate.text(1)
        axes.annotate(
            text,
            (1.0, place),
            xycoords=("axes fraction", "data"),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
        ticks.append((place, name))
        place += 1.0
    axes.set_yticks([at for at, _ in ticks], [name for _, name in ticks])
    axes.set(xlim=(0.0, limit), ylim=(place - 0.3, -0.3), xlabel=f"{label}; line: 95 % interval over objects")
    axes.grid(axis="x", color="#dddddd")
    return figure


def calibration_chart(title: str, bins: Sequence[str], series: Mapping[str, Mapping[str, GroupRate]]) -> "Figure":
    """Return a figure with the rate of each bin of each series, its 95 % interval, and how many outcomes it has."""
    figure, axes = _axes(title, height=4.2)
    for number, ((name, groups), colour) in enumerate(zip(series.items(), _colours(len(series)), strict=True)):
        aside = 0.6 * ((number + 0.5) / len(series) - 0.5)
        found = [(index + aside, groups[label]) for index, label in enumerate(bins) if label in groups]
        for at, group in found:
            axes.plot([at, at], [100 * group.rate.low, 100 * group.rate.high], color=colour, linewidth=1.5)
            axes.annotate(str(group.number), (at, -6), ha="center", va="center", fontsize=7)
        axes.plot(
            [at for at, _ in found], [100 * group.rate.value for _, group in found], "o", color=colour, label=name
        )
    axes.set_xticks(range(len(bins)), bins)
    axes.set(
        ylim=(-10.0, 104.0), xlim=(-0.5, len(bins) - 0.5), xlabel="force margin", ylabel="success [%]; below: how many"
    )
    axes.grid(axis="y", color="#dddddd")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.3), ncols=len(series), frameon=False)
    return figure


def save_chart(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG; OutputError where that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    except OSError as error:
        raise OutputError(f"cannot write the chart {path}: {error.strerror or error}") from error


def _axes(title: str, *, height: float) -> tuple["Figure", "Axes"]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height))
    axes = figure.add_subplot()
    axes.set_title(title, loc="left", fontsize=11, weight="bold")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _colours(number: int) -> list[str]:
    return [f"C{index % 10}" for index in range(number)]
