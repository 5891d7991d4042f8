"""Charts as SVG text for a page that loads nothing: stacked bars, and ranges on a common scale."""

import math
from collections.abc import Mapping, Sequence
from html import escape

SERIES_COLOURS = {"grasp": "#3b6fb6", "push": "#e07b39", "press": "#2a8f6a", "hook": "#8e5ea2"}
OTHER_COLOUR = "#66707d"
WIDTH, HEIGHT = 460.0, 190.0  # pixels of a bar chart
LEFT, RIGHT, TOP, BOTTOM = 44.0, 8.0, 26.0, 34.0  # pixels around its bars
LINE = 20.0  # pixels of one line of a range chart
LABEL_WIDTH = 36  # pixels of the longest label below a bar
NAME_WIDTH = 60.0  # pixels of its names


def bar_chart(title: str, labels: Sequence[str], series: Mapping[str, Sequence[int]]) -> str:
    """Stacked bars, one for each label, with a legend; a bar's height is its sum over the series.

    Each piece carries its number as a tooltip (an SVG title) and as the attribute data-count.
    """
    totals = [sum(values) for values in zip(*series.values(), strict=True)] or [0] * len(labels)
    highest = max([*totals, 1])
    slot = (WIDTH - LEFT - RIGHT) / max(len(labels), 1)
    scale = (HEIGHT - TOP - BOTTOM) / highest
    floor = HEIGHT - BOTTOM
    parts = [_text(4.0, 14.0, title, "title")]
    parts += [_text(LEFT - 5, floor - value * scale + 4, f"{value:g}", "right") for value in (0, highest)]
    reached = [floor] * len(labels)
    for name, values in series.items():
        for index, count in enumerate(values):
            height = count * scale
            reached[index] -= height
            if count:
                parts.append(
                    f'<rect x="{LEFT + (index + 0.08) * slot:.2f}" y="{reached[index]:.2f}" width="{0.84 * slot:.2f}" '
                    f'height="{height:.2f}" fill="{SERIES_COLOURS.get(name, OTHER_COLOUR)}" data-series="{escape(name)}" '
                    f'data-count="{count}"><title>{escape(name)} {escape(labels[index])}: {count}</title></rect>'
                )
    every = max(1, math.ceil(LABEL_WIDTH / slot))
    parts += [
        _text(LEFT + (index + 0.5) * slot, floor + 13, label, "middle")
        for index, label in enumerate(labels)
        if index % every == 0
    ]
    parts.append(f'<line x1="{LEFT}" y1="{floor}" x2="{WIDTH - RIGHT}" y2="{floor}" class="axis"/>')
    for index, name in enumerate(series):
        x = LEFT + 80 * index
        parts.append(
            f'<rect x="{x}" y="{HEIGHT - 12}" width="9" height="9" fill="{SERIES_COLOURS.get(name, OTHER_COLOUR)}"/>'
        )
        parts.append(_text(x + 13, HEIGHT - 4, name, ""))
    return _svg(WIDTH, HEIGHT, parts)


def range_chart(title: str, names: Sequence[str], ranges: Sequence[tuple[float, float, float]]) -> str:
    """One line for each name: a bar from the least to the greatest share [0..1] of its range, a mark at the median."""
    span = WIDTH - NAME_WIDTH - RIGHT
    parts = [_text(4.0, 14.0, title, "title")]
    for index, (name, (low, middle, high)) in enumerate(zip(names, ranges, strict=True)):
        y = TOP + index * LINE
        parts.append(_text(NAME_WIDTH - 6, y + 11, name, "right"))
        parts.append(f'<rect x="{NAME_WIDTH}" y="{y + 2}" width="{span}" height="10" fill="#eef1f4"/>')
        parts.append(
            f'<rect x="{NAME_WIDTH + low * span:.2f}" y="{y + 2}" width="{(high - low) * span:.2f}" height="10" '
            f'fill="{SERIES_COLOURS["grasp"]}"><title>{escape(name)}: {100 * low:.0f} to {100 * high:.0f} %</title></rect>'
        )
        x = NAME_WIDTH + middle * span
        parts.append(f'<line x1="{x:.2f}" y1="{y}" x2="{x:.2f}" y2="{y + 14}" class="mark"/>')
    return _svg(WIDTH, TOP + LINE * len(names), parts)


def _text(x: float, y: float, text: str, kind: str) -> str:
    return f'<text x="{x:.2f}" y="{y:.2f}" class="{kind}">{escape(text)}</text>'


def _svg(width: float, height: float, parts: Sequence[str]) -> str:
    # No xmlns: inside HTML it is not needed, and the page shall hold no address at all.
    return f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}" role="img">{"".join(parts)}</svg>'
