"""One HTML file that shows configurations in 3-D: no server, no internet, no plug-in."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from dexnudge.errors import InputError
from dexnudge.viewer.drawing import Drawing
from dexnudge.viewer.page_data import check_same_bodies, page_data
from dexnudge.viewer.page_text import filled_template, json_text, legend, write_text
from dexnudge.viewer.palette import Role

LARGEST_PAGE = 500  # configurations; more would make the page slow to open
OPACITY = 40  # [%] of the surroundings at first
LEGEND: dict[Role, str] = {
    "object": "object",
    "fingertip": "fingertips",
    "contact": "contacts",
    "arrow": "motion",
    "environment": "surroundings",
}
HEAD = """<th>#</th><th class="text">verdict</th><th>object<br>mm</th><th>surr.<br>mm</th><th>self<br>mm</th>
<th>force<br>margin</th><th class="text">contact links</th>"""


@dataclass(frozen=True)
class Figures:
    """What was measured of one configuration: depths [m], 0 where nothing penetrates; `reason` if it was rejected."""

    success: bool
    penetration_object: float
    penetration_environment: float
    penetration_self: float
    force_margin: float
    contact_links: tuple[str, ...] = ()
    reason: str = ""


def write_page(
    drawings: Sequence[Drawing], path: Path | str, *, title: str, figures: Sequence[Figures], subtitle: str = ""
) -> Path:
    """Writes the page: a 3-D view, and a table in which a configuration is chosen, verified ones first.

    Args:
        drawings: the configurations, of the same bodies in the same order (as `drawing.drawings` returns them). Their
            place in this sequence is the number that the page gives them. At most 500 are shown.
        path: of the HTML file.
        title: plain text; whatever stands in it is shown, never interpreted.
        figures: the numbers of each drawing.
        subtitle: plain text, as the title.

    Raises:
        InputError: no drawing, not one entry of figures for each, or drawings of different bodies.
        OutputError: the file cannot be written.
    """
    _check(drawings, figures)
    order = sorted(range(len(drawings)), key=lambda index: not figures[index].success)[:LARGEST_PAGE]
    if len(order) < len(drawings):
        subtitle = f"{subtitle} The first {len(order)} of {len(drawings)} are shown.".strip()
    page = filled_template(
        "page.html",
        ("page.css",),
        ("stage.js", "page.js"),
        title=escape(title),
        subtitle=escape(subtitle),
        last=len(order) - 1,
        opacity=OPACITY,
        legend=legend(LEGEND),
        head=HEAD,
        rows="\n".join(_row(index, figures[index]) for index in order),
        data=json_text(page_data([drawings[index] for index in order])),
    )
    return write_text(page, path)


def _check(drawings: Sequence[Drawing], figures: Sequence[Figures]) -> None:
    if not drawings:
        raise InputError("a page of no configurations was asked for; expected at least one")
    if len(figures) != len(drawings):
        raise InputError(
            f"figures of {len(figures)} configurations were given for {len(drawings)}; expected one entry for each"
        )
    check_same_bodies(drawings)


def _row(index: int, figures: Figures) -> str:
    verdict, kind = ("verified", "yes") if figures.success else (figures.reason or "rejected", "no")
    depths = (figures.penetration_object, figures.penetration_environment, figures.penetration_self)
    numbers = [*(1e3 * depth for depth in depths), figures.force_margin]
    return (
        f'<tr><td>{index}</td><td class="text {kind}">{escape(verdict)}</td>'
        + "".join(f"<td>{_number(value)}</td>" for value in numbers)
        + f'<td class="text">{escape(", ".join(figures.contact_links))}</td></tr>'
    )


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "&ndash;"
