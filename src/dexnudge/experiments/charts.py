"""Charts of experiments, drawn by matplotlib (extra `plots`); reports go without them where it is not installed."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dexnudge.errors import OutputError
from dexnudge.experiments.statistics import Estimate

if TYPE_CHECKING:
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
    from matplotlib.figure import Figure

    rows = [(group, name, estimate) for group, bars in groups.items() for name, estimate in bars.items()]
    factor = 100.0 if share else 1.0
    figure = Figure(figsize=(WIDTH, 1.2 + ROW * (len(rows) + len(groups))))
    axes = figure.add_subplot()
    ends = [factor * end for _, _, e in rows for end in (e.value, e.high) if np.isfinite(end)]
    limit = 100.0 if share else 1.05 * max(ends, default=1.0) or 1.0
    place, ticks, last = 0.0, [], ""
    colours = {group: f"C{index % 10}" for index, group in enumerate(groups)}
    for group, name, estimate in rows:
        if group != last:
            place, last = place + 1.0, group
            axes.text(0.0, place - 0.8, group, weight="bold", va="center", color=INK)
        value, low, high = (min(factor * x, limit) for x in (estimate.value, estimate.low, estimate.high))
        axes.barh(place, value, height=0.7, color=colours[group], alpha=0.75)
        axes.plot([low, high], [place, place], color=INK, linewidth=1.5)
        text = estimate.percent() if share else estimate.text(1)
        axes.text(1.01, place, text, transform=axes.get_yaxis_transform(), va="center", fontsize=8)
        ticks.append((place, name))
        place += 1.0
    axes.set_title(title, loc="left", fontsize=11, weight="bold")
    axes.set_yticks([at for at, _ in ticks], [name for _, name in ticks])
    axes.set(xlim=(0.0, limit), ylim=(place - 0.3, -0.3), xlabel=f"{label}; line: 95 % interval over objects")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", color="#dddddd")
    return figure


def grid_chart(
    title: str,
    panels: Mapping[tuple[str, str], Mapping[tuple[float, float], float]],
    *,
    label: str,
    columns: str,
    rows: str,
) -> "Figure":
    """Return a figure of shares by two sizes, each panel and each cell by its (row, column).

    label: what is shared. columns, rows: what the sizes of a panel are. Cells that are missing stay empty.
    """
    from matplotlib.figure import Figure

    down, across = (list(dict.fromkeys(name[axis] for name in panels)) for axis in (0, 1))
    figure = Figure(figsize=(WIDTH, 0.8 + WIDTH / len(across) * 0.75 * len(down)), layout="constrained")
    axes = figure.subplots(len(down), len(across), squeeze=False)
    for (row, column), cells in panels.items():
        panel = axes[down.index(row)][across.index(column)]
        low, high = (sorted({size[axis] for size in cells}) for axis in (0, 1))
        shares = np.array([[100.0 * cells.get((one, other), np.nan) for other in high] for one in low])
        panel.imshow(shares, cmap="RdYlGn", vmin=0.0, vmax=100.0, aspect="auto", alpha=0.8)
        for place, share in np.ndenumerate(shares):
            if np.isfinite(share):
                panel.text(place[1], place[0], f"{share:.0f}", ha="center", va="center", fontsize=8, color=INK)
        panel.set_xticks(range(len(high)), [f"{size:g}" for size in high], fontsize=8)
        panel.set_yticks(range(len(low)), [f"{size:g}" for size in low], fontsize=8)
        panel.set_title(f"{column}, {row}", loc="left", fontsize=9)
        panel.set_xlabel(columns, fontsize=8)
        panel.set_ylabel(rows, fontsize=8)
    figure.suptitle(f"{title}: {label}", fontsize=11, weight="bold")
    return figure


def save_chart(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG; OutputError where that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    except OSError as error:
        raise OutputError(f"cannot write the chart {path}: {error.strerror or error}") from error
