"""Charts of experiments, drawn by matplotlib (extra `plots`); reports go without them where it is not installed."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from dexnudge.errors import writing
from dexnudge.experiments.statistics import Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AVAILABLE = find_spec("matplotlib") is not None
MISSING = "Charts need matplotlib: `pip install 'dexnudge[plots]'`."
WIDTH = 8.0  # [inch]
ROW = 0.3  # [inch] of height for each bar
DPI = 120
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
        axes.plot([low, high], [place, place], color=INK, linewidth=1.5)
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


def save_chart(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG; OutputError where that fails."""
    with writing(f"the chart {path}"):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI, bbox_inches="tight", metadata={"Software": None})
