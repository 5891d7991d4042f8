"""Curves over time as SVG for a page: phases as bands, and a cursor that the page's script moves."""

import math
from collections.abc import Callable, Sequence
from html import escape

import numpy as np
from jaxtyping import Float

from dexnudge.viewer.recording import Curve, Recording

COLOURS = ("#3b6fb6", "#e07b39", "#2a8f6a", "#8e5ea2")  # of a chart's curves, in turn
BANDS = ("#f4f6f8", "#e9edf2")  # of phases, alternating
WIDTH, HEIGHT = 440.0, 122.0  # pixels
LEFT, RIGHT, TOP, BOTTOM = 44.0, 8.0, 24.0, 28.0  # pixels around the curves
NAME_WIDTH = 5.5  # pixels of a letter of a phase's name
NAME_ROWS = (HEIGHT - 17, HEIGHT - 6)  # pixels from the top: names that would meet in one go to the other
TICKS = 3  # numbers beside the axis, about
NOISE = 0.03  # of a chart's range: what lies less beyond 0 gets no room of its own
LEAST_RANGE = 1.0  # in a curve's own unit, so that a quantity that stays does not fill its chart with noise


def recording_charts(recording: Recording) -> list[str]:
    """Return one SVG for each chart of the recording; `data-left` and `data-width` tell where its time axis lies."""
    return [_chart(title, curves, recording) for title, curves in recording.charts.items()]


def phase_spans(recording: Recording) -> list[tuple[str, float, float]]:
    """Return name, beginning and end [s] of each phase in order; a phase ends where the next one begins."""
    phase, time = recording.phase, recording.time.tolist()
    starts = [index for index in range(len(phase)) if index == 0 or phase[index] != phase[index - 1]]
    ends = [*starts[1:], len(phase) - 1]
    return [(phase[start], time[start], time[end]) for start, end in zip(starts, ends, strict=True)]


def _chart(title: str, curves: Sequence[Curve], recording: Recording) -> str:
    low, high, step = _scale(np.concatenate([curve.values for curve in curves]))
    first, last = float(recording.time[0]), float(recording.time[-1])
    width, height = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    across = width / max(last - first, 1e-9)
    up = height / (high - low)

    def place(time: float, value: float) -> tuple[float, float]:
        return LEFT + (time - first) * across, TOP + (high - value) * up

    parts = []
    taken = dict.fromkeys(NAME_ROWS, 0.0)
    for index, (name, begin, end) in enumerate(phase_spans(recording)):
        x, wide = place(begin, low)[0], (end - begin) * across
        parts.append(f'<rect x="{x:.1f}" y="{TOP}" width="{wide:.1f}" height="{height}" fill="{BANDS[index % 2]}">')
        parts.append(f"<title>{escape(name)}</title></rect>")
        half = NAME_WIDTH * len(name) / 2
        middle = min(x + wide / 2, WIDTH - half)
        row = next((row for row, end in taken.items() if middle - half >= end), None)
        if row is not None and name:  # where many short phases follow each other, the band's title still says it
            taken[row] = middle + half
            parts.append(f'<text x="{middle:.1f}" y="{row}" class="phase">{escape(name)}</text>')
    for tick in np.arange(low, high + step / 2, step).tolist():
        y = place(first, tick)[1]
        parts.append(f'<line x1="{LEFT}" y1="{y:.1f}" x2="{WIDTH - RIGHT}" y2="{y:.1f}" class="grid"/>')
        parts.append(f'<text x="{LEFT - 5}" y="{y + 4:.1f}" class="tick">{tick:g}</text>')
    x = 4.0
    parts.append(f'<text x="{x}" y="14" class="title">{escape(title)}</text>')
    x += 7.0 * len(title) + 12
    for curve, colour in zip(curves, COLOURS, strict=False):
        points = _points(recording.time, curve.values, place)
        parts += [f'<polyline points="{run}" stroke="{colour}" class="curve"/>' for run in points]
        parts.append(
            f'<text x="{x:.0f}" y="14" fill="{colour}">{escape(curve.name)} <tspan data-value=""></tspan></text>'
        )
        x += 6.0 * len(curve.name) + 66
    parts.append(f'<line x1="{LEFT}" y1="{TOP}" x2="{LEFT}" y2="{HEIGHT - BOTTOM}" class="cursor"/>')
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {HEIGHT:g}" data-left="{LEFT:g}" data-width="{width:g}" role="img">'
        f"{''.join(parts)}</svg>"
    )


def _points(
    time: Float[np.ndarray, " frame"],
    values: Float[np.ndarray, " frame"],
    place: Callable[[float, float], tuple[float, float]],
) -> list[str]:
    """Return the corners of a polyline for each stretch of finite values."""
    runs: list[list[str]] = [[]]
    for moment, value in zip(time.tolist(), values.tolist(), strict=True):
        if math.isfinite(value):
            x, y = place(moment, value)
            runs[-1].append(f"{x:.1f},{y:.1f}")
        elif runs[-1]:
            runs.append([])
    return [" ".join(run) for run in runs if run]


def _scale(values: Float[np.ndarray, " value"]) -> tuple[float, float, float]:
    """Return low and high end of an axis that holds 0 and the finite values, and its step: 1, 2 or 5 by a power of ten."""
    finite = values[np.isfinite(values)]
    low, high = min(0.0, float(finite.min(initial=0.0))), max(0.0, float(finite.max(initial=0.0)))
    low, high = (end if abs(end) > NOISE * (high - low) else 0.0 for end in (low, high))
    if high - low < LEAST_RANGE:
        high = low + LEAST_RANGE
    rough = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * (1 - 1e-9))
    return step * math.floor(low / step + 1e-9), step * math.ceil(high / step - 1e-9), step
