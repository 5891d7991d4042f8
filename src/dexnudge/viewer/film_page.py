"""One HTML file that plays a film in 3-D, with its curves beside it: no server, no internet, no plug-in."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.viewer.film_chart import film_charts
from dexnudge.viewer.page import ASPECT, check_same_bodies, filled_template, json_text, legend, page_data, write_text
from dexnudge.viewer.recording import Film, film_camera
from dexnudge.viewer.visual_scene import Role

MOST_FRAMES = 1000  # a longer film is thinned, so that the page stays below a few megabytes
OPACITY = 40  # [%] of the surroundings at first
DIGITS = 4  # of a curve's numbers behind the point
LEGEND: dict[Role, str] = {
    "object": "object",
    "fingertip": "fingertips",
    "arrow": "motion",
    "environment": "surroundings",
}


def write_film_page(film: Film, path: Path | str) -> Path:
    """Write the page: a 3-D view, a slider over time with play and pause, and the film's charts with a cursor.

    Raises:
        InputError: frames of different bodies.
        OutputError: the file cannot be written.
    """
    check_same_bodies(film.frames)
    if len(film.frames) > MOST_FRAMES:
        film = film.part(film.evenly(MOST_FRAMES))
    page = filled_template(
        "film_page.html",
        ("page.css", "film_page.css"),
        ("stage.js", "film_page.js"),
        title=escape(film.title),
        subtitle=escape(film.subtitle),
        last=len(film.frames) - 1,
        opacity=OPACITY,
        legend=legend(LEGEND),
        charts="\n".join(film_charts(film)),
        data=json_text(_data(film)),
    )
    return write_text(page, path)


def _data(film: Film) -> dict[str, Any]:
    """What `page_data` has of the frames, with their times, phases, arrows and curves in the order of the charts.

    arrows: how far the object, and with it the arrow, has moved since the first frame [m]; null where there is none.
    """
    origins = np.stack([frame.with_role("object")[0].T_world_part[:3, 3] for frame in film.frames])
    arrows = [
        np.round(moved, DIGITS + 1).tolist() if np.any(frame.motion) else None
        for frame, moved in zip(film.frames, origins - origins[0], strict=True)
    ]
    return {
        **page_data(film.frames, camera=film_camera(film, aspect=ASPECT)),
        "time": np.round(film.time, DIGITS).tolist(),
        "phase": list(film.phase),
        "arrows": arrows,
        "curves": [
            {
                "unit": curve.unit,
                "values": [
                    round(value, DIGITS) if finite else None
                    for value, finite in zip(curve.values.tolist(), np.isfinite(curve.values).tolist(), strict=True)
                ],
            }
            for curves in film.charts.values()
            for curve in curves
        ],
    }
