"""Figures as tables and charts: markdown for reports, CSV for programs; charts by matplotlib (extra `plots`)."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dexnudge.errors import writing
from dexnudge.experiments.metrics import GroupRate, Measured, Metric
from dexnudge.experiments.statistics import Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Table:
    """Columns under a header; the first `labels` columns are text, the others numbers."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    labels: int = 2

    def markdown(self) -> str:
        """Return the table as markdown; "None." where it has no rows."""
        if not self.rows:
            return "None."
        marks = ["---"] * self.labels + ["---:"] * (len(self.header) - self.labels)
        return "\n".join("| " + " | ".join(map(str, cells)) + " |" for cells in [self.header, marks, *self.rows])


def method_table(methods: Iterable[str]) -> Table:
    """Return what each method does, once."""
    from dexnudge.sampling.methods import find_method

    return Table(["method", "what"], [[each, find_method(each).summary] for each in dict.fromkeys(methods)])


def metric_table(measured: Sequence[Measured], metrics: Sequence[Metric], labels: Sequence[str] = ()) -> Table:
    """Return a row for each scene and method; metrics without a header, or that none of them has, are left out.

    labels: names of further labels in `measured`, between method and metrics.
    """
    shown = [each for each in metrics if each.header and any(row[each.name] is not None for row in measured)]
    rows = [
        [row["scene"], row["method"], *(row[label] for label in labels), *(each.text(row[each.name]) for each in shown)]
        for row in measured
    ]
    return Table(["scene", "method", *labels, *(each.header for each in shown)], rows, labels=2 + len(labels))


def count_table(measured: Sequence[Measured], name: str) -> Table:
    """Return a row for each scene and method, and a column for everything that a metric of counts has counted."""
    keys = dict.fromkeys(key for row in measured for key in row[name])
    rows = [[row["scene"], row["method"], *(row[name].get(key, 0) for key in keys)] for row in measured if keys]
    return Table(["scene", "method", *keys], rows)


def group_table(name: str, found: Mapping[str, Mapping[str, GroupRate]]) -> Table:
    """Return a row for each group of the first column of `found`: column -> group -> rate."""

    def cell(group: GroupRate | None) -> str:
        return "" if group is None else f"{group.rate.percent()}, n = {group.number}"

    first = next(iter(found.values()), {})
    rows = [[label, *(cell(groups.get(label)) for groups in found.values())] for label in first]
    return Table([name, *found], rows, labels=1)


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of figures as CSV: an estimate as NAME, NAME_low, NAME_high; an entry of a dict as NAME.KEY."""
    flat = [dict(_flat(row)) for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in flat for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return text.getvalue()


def _flat(row: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, Estimate):
            ends = {name: value.value, f"{name}_low": value.low, f"{name}_high": value.high}
            yield from ((key, f"{number:.6g}" if np.isfinite(number) else "") for key, number in ends.items())
        elif isinstance(value, dict):
            yield from _flat({f"{name}.{key}": entry for key, entry in value.items()})
        else:
            yield name, f"{value:.6g}" if isinstance(value, float) else value


AVAILABLE = find_spec("matplotlib") is not None
MISSING = "Charts need matplotlib: `pip install 'dexnudge[plots]'`."
WIDTH = 8.0  # [inch]
ROW = 0.3  # [inch] of height for each bar
DPI = 120
SHIFT = 0.02  # of a point for each further line
INK = "#222222"


def interval_chart(title: str, groups: Mapping[str, Mapping[str, Estimate]]) -> "Figure":
    """Return a figure of rates of success: a bar for each name in each group, and its 95 % interval as a line."""
    from matplotlib.figure import Figure

    rows = [(group, name, estimate) for group, bars in groups.items() for name, estimate in bars.items()]
    figure = Figure(figsize=(WIDTH, 1.2 + ROW * (len(rows) + len(groups))))
    axes = figure.add_subplot()
    place, ticks, last = 0.0, [], ""
    colours = {group: f"C{index % 10}" for index, group in enumerate(groups)}
    for group, name, estimate in rows:
        if group != last:
            place, last = place + 1.0, group
            axes.text(0.0, place - 0.8, group, weight="bold", va="center", color=INK)
        value, low, high = (100.0 * x for x in (estimate.value, estimate.low, estimate.high))
        axes.barh(place, value, height=0.7, color=colours[group], alpha=0.75)
        axes.plot([low, high], [place, place], "|-", color=INK, linewidth=1.5)  # the ends are seen where both are 0
        axes.text(1.01, place, estimate.percent(), transform=axes.get_yaxis_transform(), va="center", fontsize=8)
        ticks.append((place, name))
        place += 1.0
    axes.set_title(title, loc="left", fontsize=11, weight="bold")
    axes.set_yticks([at for at, _ in ticks], [name for _, name in ticks])
    axes.set(xlim=(0.0, 100.0), ylim=(place - 0.3, -0.3), xlabel="success [%]; line: 95 % interval over objects")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", color="#dddddd")
    return figure


def factor_chart(title: str, panels: Mapping[str, Mapping[str, Mapping[float, Estimate]]]) -> "Figure":
    """Return a figure of rates of success over a factor: a panel for each quantity, a line for each way to act.

    panels: quantity -> way -> factor -> rate, with its 95 % interval as a vertical line.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 3.2))
    for place, (quantity, ways) in enumerate(panels.items()):
        axes = figure.add_subplot(1, len(panels), place + 1)
        for colour, (way, rates) in enumerate(ways.items()):
            factors = sorted(rates)
            shown = [rates[factor] for factor in factors]
            at = [factor * (1.0 + SHIFT * colour) for factor in factors]  # so that no interval hides another
            axes.plot(at, [100.0 * each.value for each in shown], "o-", color=f"C{colour}", label=way, markersize=4)
            axes.vlines(
                at, [100.0 * e.low for e in shown], [100.0 * e.high for e in shown], color=f"C{colour}", alpha=0.6
            )
        axes.set(xscale="log", ylim=(0.0, 103.0), xlabel=f"{quantity.replace('_', ' ')}, times planned")
        every = sorted({factor for rates in ways.values() for factor in rates})
        axes.set_xticks(every, [f"{factor:g}" for factor in every])
        axes.minorticks_off()
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color="#dddddd")
        if place == 0:
            axes.set_ylabel("success [%]")
            axes.legend(fontsize=8, frameon=False, loc="lower right")
    figure.suptitle(title, x=0.02, ha="left", fontsize=11, weight="bold")
    figure.tight_layout()
    return figure


def save_chart(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG; OutputError where that fails."""
    with writing(f"the chart {path}"):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI, bbox_inches="tight", metadata={"Software": None})
