"""One HTML file that shows configurations in 3-D: no server, no internet, no plug-in."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import trimesh

from dexnudge.errors import InputError, OutputError
from dexnudge.viewer.camera import TAN_HALF_HEIGHT
from dexnudge.viewer.drawing import Drawing
from dexnudge.viewer.page_geometry import encoded, page_geometry
from dexnudge.viewer.palette import PALETTE, Role
from dexnudge.viewer.viewpoint import choose_camera

ASPECT = 4 / 3  # of the stage for which the first view is chosen
BALL_RADIUS = 0.0035  # [m] of a contact
LARGEST_PAGE = 500  # configurations; more would make the page slow to open
OPACITY = 40  # [%] of the surroundings at first
EDGE = (0.42, 0.42, 0.44)  # sRGB of the surroundings' edges
LEGEND: dict[Role, str] = {
    "object": "object",
    "fingertip": "fingertips",
    "contact": "contacts",
    "arrow": "motion",
    "environment": "surroundings",
}
MOVING: tuple[Role, ...] = ("object", "link", "fingertip", "base")
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
    package = files("dexnudge.viewer")
    page = Template((package / "page.html").read_text(encoding="utf-8")).substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        last=len(order) - 1,
        opacity=OPACITY,
        legend="".join(_legend(role, text) for role, text in LEGEND.items()),
        head=HEAD,
        rows="\n".join(_row(index, figures[index]) for index in order),
        data=_json(_data([drawings[index] for index in order])),
        script=(package / "page.js").read_text(encoding="utf-8"),
    )
    path = Path(path)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"the page {path} cannot be written: {error}; expected a folder that exists and is writable"
        ) from error
    return path


def _check(drawings: Sequence[Drawing], figures: Sequence[Figures]) -> None:
    if not drawings:
        raise InputError("a page of no configurations was asked for; expected at least one")
    if len(figures) != len(drawings):
        raise InputError(
            f"figures of {len(figures)} configurations were given for {len(drawings)}; expected one entry for each"
        )
    bodies = [[(id(part.mesh), part.role) for part in drawing.parts] for drawing in drawings]
    for index, other in enumerate(bodies):
        if other != bodies[0]:
            raise InputError(
                f"drawing {index} shows other bodies than drawing 0; expected the same meshes in the same order; "
                "write one page for each scene"
            )


def _row(index: int, figures: Figures) -> str:
    verdict, kind = ("verified", "yes") if figures.success else (figures.reason or "rejected", "no")
    depths = (figures.penetration_object, figures.penetration_environment, figures.penetration_self)
    numbers = [*(1e3 * depth for depth in depths), figures.force_margin]
    return (
        f'<tr><td>{index}</td><td class="text {kind}">{escape(verdict)}</td>'
        + "".join(f"<td>{_number(value)}</td>" for value in numbers)
        + f'<td class="text">{escape(", ".join(figures.contact_links))}</td></tr>'
    )


def _legend(role: Role, text: str) -> str:
    red, green, blue = (round(255 * channel) for channel in PALETTE[role])
    return f'<span><i style="background:rgb({red} {green} {blue})"></i>{text}</span>'


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "&ndash;"


def _json(data: Any) -> str:
    """JSON that cannot end the script element that holds it."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _data(drawings: Sequence[Drawing]) -> dict[str, Any]:
    first = drawings[0]
    meshes: dict[int, trimesh.Trimesh] = {id(part.mesh): part.mesh for part in first.parts}
    place = {key: index for index, key in enumerate(meshes)}
    extra = [first.arrow().mesh, trimesh.creation.icosphere(subdivisions=2, radius=BALL_RADIUS)]
    return {
        "geometries": [page_geometry(mesh) for mesh in [*meshes.values(), *extra]],
        "arrow": len(meshes),
        "ball": len(meshes) + 1,
        "bodies": [
            {"geometry": place[id(part.mesh)], "role": part.role, "moves": part.role in MOVING} for part in first.parts
        ],
        "configurations": [
            {
                "poses": encoded(np.stack([part.T_world_part[:3] for part in drawing.parts]).astype(np.float32)),
                "contacts": np.round(drawing.contacts, 5).tolist(),
            }
            for drawing in drawings
        ],
        "palette": {**PALETTE, "edge": EDGE},
        "motion": first.motion.tolist(),
        "motion_length": first.motion_length,
        "camera": _camera(first),
    }


def _camera(drawing: Drawing) -> dict[str, Any]:
    """The best view of the first configuration, as the page turns it: about a point near the object."""
    camera = choose_camera(drawing, aspect=ASPECT)
    middle = np.concatenate([part.vertices_in_world() for part in drawing.with_role("object")]).mean(axis=0)
    distance = float((middle - camera.position) @ camera.forward)
    return {
        "target": (camera.position + distance * camera.forward).tolist(),
        "distance": distance,
        "azimuth": float(np.arctan2(-camera.forward[1], -camera.forward[0])),
        "elevation": float(np.arcsin(-camera.forward[2])),
        "tangent": TAN_HALF_HEIGHT,
    }
