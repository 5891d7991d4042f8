"""One HTML file that shows configurations or plays a recording in 3-D: no server, no internet, no plug-in."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from itertools import cycle
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, check_path, writing
from dexnudge.finding import probability_text
from dexnudge.viewer.page_data import ASPECT, page_data
from dexnudge.viewer.recording import Curve, Recording, recording_camera
from dexnudge.viewer.visual_scene import Colour, VisualScene, legend

COLOURS = ("#3b6fb6", "#e07b39", "#2a8f6a", "#8e5ea2", "#c0392b", "#2aa5b8", "#a5921b", "#d16ba5", "#7f6d5f", "#5c7a29")
LIMIT_COLOUR = "#66707d"
BANDS = ("#f4f6f8", "#e9edf2")  # of phases, alternating
WIDTH, HEIGHT = 440.0, 70.0  # pixels, of the curves in height
LEFT, RIGHT, BOTTOM = 44.0, 8.0, 28.0  # pixels around the curves
LEGEND_ROW = 14.0  # pixels from one row of curves' names to the next
TITLE_LETTER, LETTER, READING = 7.0, 6.0, 54.0  # pixels of a letter of a chart's title, of a curve's name; of its value
NAME_WIDTH = 5.5  # pixels of a letter of a phase's name
NAME_ROWS = (11.0, 22.0)  # pixels below the curves: names that would meet in one go to the other
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
    names = _legend(title, curves)
    top = names[-1][1] + 10.0
    bottom, width = top + HEIGHT, WIDTH - LEFT - RIGHT
    across = width / max(last - first, 1e-9)
    up = HEIGHT / (high - low)

    def place(time: float, value: float) -> tuple[float, float]:
        return LEFT + (time - first) * across, top + (high - value) * up

    parts = []
    taken = dict.fromkeys(NAME_ROWS, 0.0)
    for index, (name, begin, end) in enumerate(phase_spans(recording)):
        x, wide = place(begin, low)[0], (end - begin) * across
        parts.append(f'<rect x="{x:.1f}" y="{top:g}" width="{wide:.1f}" height="{HEIGHT:g}" fill="{BANDS[index % 2]}">')
        parts.append(f"<title>{escape(name)}</title></rect>")
        half = NAME_WIDTH * len(name) / 2
        middle = min(x + wide / 2, WIDTH - half)
        row = next((row for row, end in taken.items() if middle - half >= end), None)
        if row is not None and name:  # where many short phases follow each other, the band's title still says it
            taken[row] = middle + half
            parts.append(f'<text x="{middle:.1f}" y="{bottom + row:g}" class="phase">{escape(name)}</text>')
    for tick in np.arange(low, high + step / 2, step).tolist():
        y = place(first, tick)[1]
        parts.append(f'<line x1="{LEFT}" y1="{y:.1f}" x2="{WIDTH - RIGHT}" y2="{y:.1f}" class="grid"/>')
        parts.append(f'<text x="{LEFT - 5}" y="{y + 4:.1f}" class="tick">{tick:g}</text>')
    parts.append(f'<text x="4" y="{LEGEND_ROW:g}" class="title">{escape(title)}</text>')
    turns = cycle(COLOURS)
    colours = [LIMIT_COLOUR if curve.limit else next(turns) for curve in curves]
    for curve, colour, (x, y) in zip(curves, colours, names, strict=True):
        points = _points(recording.time, curve.values, place)
        dashed = ' stroke-dasharray="4 3"' if curve.limit else ""
        parts += [f'<polyline points="{run}" stroke="{colour}" class="curve"{dashed}/>' for run in points]
        name = f'{escape(curve.name)} <tspan data-value=""></tspan>'
        parts.append(f'<text x="{x:.0f}" y="{y:g}" fill="{colour}">{name}</text>')
    parts.append(f'<line x1="{LEFT}" y1="{top:g}" x2="{LEFT}" y2="{bottom:g}" class="cursor"/>')
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {bottom + BOTTOM:g}" data-left="{LEFT:g}" data-width="{width:g}" role="img">'
        f"{''.join(parts)}</svg>"
    )


def _legend(title: str, curves: Sequence[Curve]) -> list[tuple[float, float]]:
    """Return where the name of each curve stands [pixels]: behind the title, in as many rows as they need."""
    x, y = TITLE_LETTER * len(title) + 16, LEGEND_ROW
    places: list[tuple[float, float]] = []
    for curve in curves:
        wide = LETTER * len(curve.name) + READING
        if x + wide > WIDTH and places:
            x, y = LEFT, y + LEGEND_ROW
        places.append((x, y))
        x += wide + 12
    return places


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


LARGEST_PAGE = 500  # configurations; more would make the page slow to open
MOST_FRAMES = 1000  # a longer recording is thinned, so that the page stays below a few megabytes
OPACITY = 40  # [%] of the surroundings at first
DECIMALS = 4  # of a curve's numbers
PERCENT = 100.0
MILLIMETRES = 1e3  # depths are measured in metres and shown in millimetres
HEADINGS = {  # of values that are shown under another name or in another unit than they have: heading, factor
    "penetration_object": ("object<br>mm", MILLIMETRES),
    "penetration_environment": ("surr.<br>mm", MILLIMETRES),
    "penetration_self": ("self<br>mm", MILLIMETRES),
    "force_margin": ("force<br>margin", 1.0),
    "probability": ("probability<br>%", PERCENT),
    "share_of_worlds": ("worlds<br>%", PERCENT),
}


@dataclass(frozen=True)
class Figures:
    """What was measured of one configuration.

    Attributes:
        success: whether it meets all criteria.
        values: what each criterion measured, by the criterion's name and in its own unit (depths in metres); NaN where
            it measured nothing. Each name is a column of the page, a user's own included.
        contact_links: names of the links that touch the object.
        reason: the first criterion that failed; "" for a success.
    """

    success: bool
    values: Mapping[str, float]
    contact_links: tuple[str, ...] = ()
    reason: str = ""


def write_page(scenes: Sequence[VisualScene], path: Path | str, *, title: str, figures: Sequence[Figures]) -> Path:
    """Write the page: a 3-D view, and a table in which a configuration is chosen, verified ones first.

    Args:
        scenes: the configurations, of the same bodies in the same order (as `visual_scenes` returns them). Their place
            in this sequence is the number that the page gives them. At most 500 are shown.
        path: of the HTML file.
        title: plain text; whatever stands in it is shown, never interpreted.
        figures: the numbers of each configuration; a value that one of them lacks is shown as a dash.

    Raises:
        InputError: no configuration, not one entry of figures for each, or scenes of different bodies.
        OutputError: the file cannot be written.
    """
    if not scenes:
        raise InputError("a page of no configurations was asked for; expected at least one")
    if len(figures) != len(scenes):
        raise InputError(
            f"figures of {len(figures)} configurations were given for {len(scenes)}; expected one entry for each"
        )
    order = sorted(range(len(scenes)), key=lambda index: not figures[index].success)[:LARGEST_PAGE]
    cut = f"The first {len(order)} of {len(scenes)} are shown." if len(order) < len(scenes) else ""
    names = list(dict.fromkeys(name for each in figures for name in each.values))
    return write_template(
        path,
        "configurations",
        page_data([scenes[index] for index in order]),
        legend(scenes),
        title=escape(title),
        subtitle=cut,
        last=len(order) - 1,
        head=_head(names),
        rows="\n".join(_row(index, figures[index], names) for index in order),
    )


def _head(names: Sequence[str]) -> str:
    headings = [HEADINGS[name][0] if name in HEADINGS else escape(name.replace("_", " ")) for name in names]
    columns = "".join(f"<th>{heading}</th>" for heading in headings)
    return f'<th>#</th><th class="text">verdict or<br>first reason</th>{columns}<th class="text">contact links</th>'


def _row(index: int, figures: Figures, names: Sequence[str]) -> str:
    verdict, kind = ("verified", "yes") if figures.success else (figures.reason or "rejected", "no")
    numbers = "".join(f"<td>{_number(name, figures.values.get(name, math.nan))}</td>" for name in names)
    links = escape(", ".join(figures.contact_links))
    return (
        f'<tr><td>{index}</td><td class="text {kind}">{escape(verdict)}</td>{numbers}<td class="text">{links}</td></tr>'
    )


def _number(name: str, value: float) -> str:
    if not math.isfinite(value):
        return "&ndash;"
    if name not in HEADINGS:
        return f"{value:.4g}"
    if name == "probability":
        return escape(probability_text(value).rstrip("%"))
    factor = HEADINGS[name][1]
    return f"{factor * value:.{0 if factor == PERCENT else 2}f}"


def write_recording_page(recording: Recording, path: Path | str) -> Path:
    """Write the page: a 3-D view, a slider over time with play and pause, and the recording's charts with a cursor.

    Raises:
        OutputError: the file cannot be written.
    """
    if len(recording.frames) > MOST_FRAMES:
        recording = recording.part(recording.evenly(MOST_FRAMES))
    return write_template(
        path,
        "recording",
        _recording_data(recording),
        legend(recording.frames),
        title=escape(recording.title),
        subtitle=escape(recording.subtitle),
        last=len(recording.frames) - 1,
        charts="\n".join(recording_charts(recording)),
    )


def _recording_data(recording: Recording) -> dict[str, Any]:
    """Return what `page_data` has of the frames, with their times, phases, arrows and curves in the order of the charts.

    arrows: whether there is one, which stays where it is.
    """
    curves = [curve for together in recording.charts.values() for curve in together]
    return {
        **page_data(recording.frames, camera=recording_camera(recording, aspect=ASPECT)),
        "time": np.round(recording.time, DECIMALS).tolist(),
        "phase": list(recording.phase),
        "arrows": [frame.has_arrow for frame in recording.frames],
        "curves": [
            {
                "unit": curve.unit,
                "values": [round(each, DECIMALS) if math.isfinite(each) else None for each in curve.values.tolist()],
            }
            for curve in curves
        ],
    }


def write_template(
    path: Path | str,
    kind: str,
    data: dict[str, Any],
    shown: Mapping[str, Colour],
    **values: object,
) -> Path:
    """Fill the package's template of this kind, with its style and script, and write it.

    Args:
        path: of the HTML file.
        kind: of page: "configurations", "hand", "recording" or "scene".
        data: for the script, as `page_data` returns it.
        shown: what is to be seen, plain text, and its sRGB colour.
        values: HTML to be put in; text in it must be escaped already.

    Raises:
        OutputError: the file cannot be written.
    """
    check_path("path", path)
    templates = files("dexnudge.viewer") / "templates"

    def text(*names: str) -> str:
        return "".join((templates / name).read_text(encoding="utf-8") for name in names)

    entries = "".join(
        f'<span><i style="background:rgb({" ".join(str(round(255 * channel)) for channel in colour)})"></i>'
        f"{escape(name)}</span>"
        for name, colour in shown.items()
    )
    body = Template(text(f"{kind}.html")).substitute(opacity=OPACITY, legend=entries, **values)
    page = Template(text("page.html")).substitute(
        title=values["title"],
        body=body,
        style=text("page.css"),
        script=text("stage.js", f"{kind}.js"),
        data=_json_text(data),
    )
    path = Path(path)
    with writing(f"the page {path}"):
        path.write_text(page, encoding="utf-8", errors="backslashreplace")
    return path


def _json_text(data: Any) -> str:
    """Return JSON that cannot end the script element that holds it."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
