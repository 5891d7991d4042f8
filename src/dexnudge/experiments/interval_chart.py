"""Bars with their intervals, as an SVG file that any browser shows."""

import math
from collections.abc import Mapping
from html import escape

import numpy as np

from dexnudge.experiments.statistics import Estimate

COLOURS = ("#3b6fb6", "#e07b39", "#2a8f6a", "#8e5ea2", "#66707d")  # of groups, in turn
BARS, RIGHT = 340.0, 116.0  # pixels of the longest bar, and of the numbers right of it
LETTER, MARGIN = 6.3, 14.0  # pixels of a letter, rather too much than too little, and beside the names left of the bars
TOP, LINE, HEADING, BOTTOM = 30.0, 18.0, 22.0, 40.0  # pixels
BAR = 11.0  # pixels of a bar's height
TICKS = 4  # equal parts of the scale
EXPLAINED = "Bar: all objects. Line: 95 % interval over objects."
STYLE = (
    "text{font:11px sans-serif;fill:#222}.title{font-weight:bold;font-size:13px}.group{font-weight:bold}"
    ".scale{fill:#667}"
)


def interval_chart(
    title: str, groups: Mapping[str, Mapping[str, Estimate]], *, limit: float | None = None, factor: float = 1.0
) -> str:
    """One bar for each name in each group, from 0 to its value, with a line from the low to the high end.

    limit: the number at the right end of the scale; a round one beyond the greatest finite end unless given. factor: on
    the numbers that are printed, 100 for percent. Each bar carries its number as the attribute data-value. Ends beyond
    the scale are cut.
    """
    bars = [estimate for group in groups.values() for estimate in group.values()]
    ends = [end for bar in bars for end in (bar.value, bar.high) if np.isfinite(end)]
    limit = limit or _round_limit(max([*ends, 1e-12]))
    names = MARGIN + LETTER * max(len(name) for group in groups.values() for name in group)
    width = max(names + BARS + RIGHT, MARGIN + 1.3 * LETTER * len(title))
    parts: list[str] = []
    y = TOP
    for index, (group, members) in enumerate(groups.items()):
        parts.append(f'<text x="8" y="{y + 14:g}" class="group">{escape(group)}</text>')
        y += HEADING
        for name, estimate in members.items():
            parts.append(_bar(name, estimate, names, y, BARS / limit, COLOURS[index % len(COLOURS)], factor))
            y += LINE
    height = y + BOTTOM
    heading = f'<text x="8" y="18" class="title">{escape(title)}</text>'
    explained = f'<text x="8" y="{height - 8:g}" class="scale">{EXPLAINED}</text>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
        f'height="{height:g}" role="img"><style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>'
        f"{heading}{_scale(names, y, factor * limit)}{''.join(parts)}{explained}</svg>\n"
    )


def _round_limit(greatest: float) -> float:
    """The least number that is not smaller and whose `TICKS` parts are round."""
    power = 10.0 ** math.floor(math.log10(greatest / TICKS))
    return TICKS * power * next((step for step in (1.0, 2.0, 2.5, 5.0) if step * power * TICKS >= greatest), 10.0)


def _scale(left: float, bottom: float, limit: float) -> str:
    """Upright lines behind the bars, each with its number."""
    parts = []
    for tick in range(TICKS + 1):
        x = left + BARS * tick / TICKS
        colour = "#222" if tick == 0 else "#dde1e6"
        parts.append(f'<line x1="{x:g}" y1="{TOP}" x2="{x:g}" y2="{bottom:g}" stroke="{colour}"/>')
        number = f"{limit * tick / TICKS:.3g}"
        parts.append(f'<text x="{x:g}" y="{bottom + 12:g}" class="scale" text-anchor="middle">{number}</text>')
    return "".join(parts)


def _bar(name: str, estimate: Estimate, left: float, y: float, scale: float, colour: str, factor: float) -> str:
    end = left + BARS
    value, low, high = (
        min(left + number * scale, end) if np.isfinite(number) else end
        for number in (estimate.value, estimate.low, estimate.high)
    )
    middle = y + BAR / 2
    numbers = [f"{factor * number:.1f}" for number in (estimate.value, estimate.low, estimate.high)]
    return (
        f'<text x="{left - 6:g}" y="{y + 10:g}" text-anchor="end">{escape(name)}</text>'
        f'<rect x="{left:g}" y="{y:g}" width="{value - left:.2f}" height="{BAR}" fill="{colour}" fill-opacity="0.75" '
        f'data-value="{estimate.value:.6g}"/>'
        f'<line x1="{low:.2f}" y1="{middle:g}" x2="{high:.2f}" y2="{middle:g}" stroke="#222" stroke-width="1.5"/>'
        f'<text x="{end + 8:g}" y="{y + 10:g}">{numbers[0]} ({numbers[1]}-{numbers[2]})</text>'
    )
