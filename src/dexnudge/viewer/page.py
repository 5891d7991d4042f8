"""One HTML file that shows configurations or plays a recording in 3-D: no server, no internet, no plug-in."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from dexnudge.errors import InputError, check_path, writing
from dexnudge.viewer.charts import recording_charts
from dexnudge.viewer.page_data import ASPECT, page_data
from dexnudge.viewer.recording import Recording, recording_camera
from dexnudge.viewer.visual_scene import PALETTE, Colour, VisualScene

LARGEST_PAGE = 500  # configurations; more would make the page slow to open
MOST_FRAMES = 1000  # a longer recording is thinned, so that the page stays below a few megabytes
OPACITY = 40  # [%] of the surroundings at first
DECIMALS = 4  # of a curve's numbers
LEGEND: dict[str, Colour] = {
    "object": PALETTE["object"],
    "fingertips": PALETTE["fingertip"],
    "contacts": PALETTE["contact"],
    "motion": PALETTE["arrow"],
    "surroundings": PALETTE["environment"],
}
MILLIMETRES = 1e3  # depths are measured in metres and shown in millimetres
HEADINGS = {  # of values that are shown under another name or in another unit than they have: heading, factor
    "penetration_object": ("object<br>mm", MILLIMETRES),
    "penetration_environment": ("surr.<br>mm", MILLIMETRES),
    "penetration_self": ("self<br>mm", MILLIMETRES),
    "force_margin": ("force<br>margin", 1.0),
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
        LEGEND,
        title=escape(title),
        subtitle=cut,
        last=len(order) - 1,
        head=_head(names),
        rows="\n".join(_row(index, figures[index], names) for index in order),
    )


def _head(names: Sequence[str]) -> str:
    headings = [HEADINGS[name][0] if name in HEADINGS else escape(name.replace("_", " ")) for name in names]
    columns = "".join(f"<th>{heading}</th>" for heading in headings)
    return f'<th>#</th><th class="text">verdict</th>{columns}<th class="text">contact links</th>'


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
    return f"{HEADINGS[name][1] * value:.2f}" if name in HEADINGS else f"{value:.4g}"


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
        {text: colour for text, colour in LEGEND.items() if text != "contacts"},
        title=escape(recording.title),
        subtitle=escape(recording.subtitle),
        last=len(recording.frames) - 1,
        charts="\n".join(recording_charts(recording)),
    )


def _recording_data(recording: Recording) -> dict[str, Any]:
    """Return what `page_data` has of the frames, with their times, phases, arrows and curves in the order of the charts.

    arrows: how far the object, and with it the arrow, has moved since the first frame [m]; null where there is none.
    """
    origins = np.stack([frame.with_role("object")[0].T_world_part[:3, 3] for frame in recording.frames])
    moved = np.round(origins - origins[0], DECIMALS + 1).tolist()
    curves = [curve for together in recording.charts.values() for curve in together]
    return {
        **page_data(recording.frames, camera=recording_camera(recording, aspect=ASPECT)),
        "time": np.round(recording.time, DECIMALS).tolist(),
        "phase": list(recording.phase),
        "arrows": [way if np.any(frame.motion) else None for frame, way in zip(recording.frames, moved, strict=True)],
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
    legend: Mapping[str, Colour],
    **values: object,
) -> Path:
    """Fill the package's template of this kind, with its style and script, and write it.

    Args:
        path: of the HTML file.
        kind: of page: "configurations", "hand", "recording" or "scene".
        data: for the script, as `page_data` returns it.
        legend: what is shown, plain text, and its sRGB colour.
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
        for name, colour in legend.items()
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
        path.write_text(page, encoding="utf-8")
    return path


def _json_text(data: Any) -> str:
    """Return JSON that cannot end the script element that holds it."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
