"""Bars with their intervals, as an SVG file that any browser shows."""

from collections.abc import Mapping
from html import escape

import numpy as np

from dexnudge.evaluation.estimate import Estimate

COLOURS = ("#3b6fb6", "#e07b39", "#2a8f6a", "#8e5ea2", "#66707d")  # of groups, in turn
WIDTH, NAMES = 640.0, 210.0  # pixels of the chart, and of the names left of its bars
RIGHT, TOP, LINE, HEADING, BOTTOM = 96.0, 30.0, 18.0, 22.0, 24.0  # pixels
BAR = 11.0  # pixels of a bar's height
STYLE = "text{font:11px sans-serif;fill:#222}.title{font-weight:bold;font-size:13px}.group{font-weight:bold}"


def interval_chart(
    title: str, groups: Mapping[str, Mapping[str, Estimate]], *, limit: float | None = None, factor: float = 1.0
) -> str:
    """One bar for each name in each group, from 0 to its value, with a line from the low to the high end.

    limit: the number at the right end of the scale; the greatest finite end unless given. factor: on the numbers that are
    printed, 100 for percent. Each bar carries its number as the attribute data-value. Ends beyond the scale are cut.
    """
    bars = [estimate for group in groups.values() for estimate in group.values()]
    ends = [end for bar in bars for end in (bar.value, bar.high) if np.isfinite(end)]
    scale = (WIDTH - NAMES - RIGHT) / (limit or max([*ends, 1e-12]))
    parts = [f'<text x="8" y="18" class="title">{escape(title)}</text>']
    y = TOP
    for index, (group, members) in enumerate(groups.items()):
        parts.append(f'<text x="8" y="{y + 14:g}" class="group">{escape(group)}</text>')
        y += HEADING
        for name, estimate in members.items():
            parts.append(_bar(name, estimate, y, scale, COLOURS[index % len(COLOURS)], factor))
            y += LINE
    height = y + BOTTOM
    parts.append(f'<line x1="{NAMES}" y1="{TOP}" x2="{NAMES}" y2="{y:g}" stroke="#222"/>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {height:g}" width="{WIDTH:g}" '
        f'height="{height:g}" role="img"><style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>'
        f"{''.join(parts)}</svg>\n"
    )


def _bar(name: str, estimate: Estimate, y: float, scale: float, colour: str, factor: float) -> str:
    end = WIDTH - RIGHT
    value, low, high = (
        min(NAMES + number * scale, end) if np.isfinite(number) else end
        for number in (estimate.value, estimate.low, estimate.high)
    )
    middle = y + BAR / 2
    numbers = [f"{factor * number:.3g}" for number in (estimate.value, estimate.low, estimate.high)]
    return (
        f'<text x="{NAMES - 6}" y="{y + 10:g}" text-anchor="end">{escape(name)}</text>'
        f'<rect x="{NAMES}" y="{y:g}" width="{value - NAMES:.2f}" height="{BAR}" fill="{colour}" fill-opacity="0.75" '
        f'data-value="{estimate.value:.6g}"/>'
        f'<line x1="{low:.2f}" y1="{middle:g}" x2="{high:.2f}" y2="{middle:g}" stroke="#222" stroke-width="1.5"/>'
        f'<text x="{end + 4}" y="{y + 10:g}">{numbers[0]} ({numbers[1]}-{numbers[2]})</text>'
    )
