"""Does the force margin foretell what happens in physics? Executed rate by bin of margin, with intervals, as SVG."""

from collections.abc import Mapping, Sequence
from html import escape

from dexnudge.experiments.experiment_lines import Group
from dexnudge.experiments.interval_chart import COLOURS

WIDTH, HEIGHT = 640.0, 340.0  # pixels
LEFT, RIGHT, TOP, BOTTOM = 52.0, 16.0, 56.0, 56.0  # pixels around the plot
SPREAD = 0.6  # of a bin's width over which the series stand side by side
STYLE = "text{font:11px sans-serif;fill:#222}.title{font-weight:bold;font-size:13px}.count{font-size:9px;fill:#666}"


def calibration_chart(title: str, bins: Sequence[str], series: Mapping[str, Mapping[str, Group]]) -> str:
    """A point for each bin of each series at its rate, a line over its interval, and how many were executed below it.

    Points carry their rate as the attribute data-rate. A bin in which a series has nothing stays empty.
    """
    slot = (WIDTH - LEFT - RIGHT) / len(bins)
    floor, scale = HEIGHT - BOTTOM, HEIGHT - TOP - BOTTOM
    parts = [f'<text x="8" y="18" class="title">{escape(title)}</text>']
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = floor - share * scale
        parts.append(f'<line x1="{LEFT}" y1="{y:g}" x2="{WIDTH - RIGHT}" y2="{y:g}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:g}" text-anchor="end">{100 * share:g}</text>')
    for index, name in enumerate(bins):
        x = LEFT + (index + 0.5) * slot
        parts.append(f'<text x="{x:g}" y="{floor + 16:g}" text-anchor="middle">{escape(name)}</text>')
    parts.append(f'<text x="{(LEFT + WIDTH) / 2:g}" y="{HEIGHT - 8:g}" text-anchor="middle">force margin</text>')
    for place, (name, groups) in enumerate(series.items()):
        colour = COLOURS[place % len(COLOURS)]
        x = LEFT + 110.0 * place
        parts.append(f'<circle cx="{x + 5:g}" cy="36" r="4" fill="{colour}"/>')
        parts.append(f'<text x="{x + 14:g}" y="40">{escape(name)}</text>')
        aside = SPREAD * slot * ((place + 0.5) / len(series) - 0.5)
        parts += [
            _point(groups[label], LEFT + (index + 0.5) * slot + aside, floor, scale, colour)
            for index, label in enumerate(bins)
            if label in groups
        ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" width="{WIDTH:g}" '
        f'height="{HEIGHT:g}" role="img"><style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>'
        f"{''.join(parts)}</svg>\n"
    )


def _point(group: Group, x: float, floor: float, scale: float, colour: str) -> str:
    value, low, high = (floor - share * scale for share in (group.rate.value, group.rate.low, group.rate.high))
    return (
        f'<line x1="{x:.2f}" y1="{low:.2f}" x2="{x:.2f}" y2="{high:.2f}" stroke="{colour}" stroke-width="1.5"/>'
        f'<circle cx="{x:.2f}" cy="{value:.2f}" r="4" fill="{colour}" data-rate="{group.rate.value:.6g}"/>'
        f'<text x="{x:.2f}" y="{floor + 30:g}" text-anchor="middle" class="count">{group.executed}</text>'
    )
