"""One HTML file that shows configurations in 3-D: no server, no internet, no plug-in."""

import base64
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
import trimesh

from dexnudge.errors import InputError, OutputError
from dexnudge.viewer.camera import TAN_HALF_HEIGHT, Camera
from dexnudge.viewer.ray_scene import CREASE_ANGLE, corner_normals
from dexnudge.viewer.viewpoint import choose_camera
from dexnudge.viewer.visual_scene import PALETTE, Role, VisualScene


def filled_template(page: str, styles: Sequence[str], scripts: Sequence[str], **values: object) -> str:
    """A template of this package with its styles and scripts, also files of this package, and further values put in."""
    package = files("dexnudge.viewer")
    style, script = (
        "".join((package / name).read_text(encoding="utf-8") for name in names) for names in (styles, scripts)
    )
    return Template((package / page).read_text(encoding="utf-8")).substitute(style=style, script=script, **values)


def json_text(data: Any) -> str:
    """JSON that cannot end the script element that holds it."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def legend(entries: Mapping[Role, str]) -> str:
    """What each colour means, as HTML."""
    return "".join(_entry(role, text) for role, text in entries.items())


def _entry(role: Role, text: str) -> str:
    red, green, blue = (round(255 * channel) for channel in PALETTE[role])
    return f'<span><i style="background:rgb({red} {green} {blue})"></i>{escape(text)}</span>'


def write_text(page: str, path: Path | str) -> Path:
    """Write a page.

    Raises:
        OutputError: the file cannot be written.
    """
    path = Path(path)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"the page {path} cannot be written: {error}; expected a folder that exists and is writable"
        ) from error
    return path


LARGEST_MESH = 40_000  # triangles; a finer mesh is thinned, so that a page stays below a few megabytes
NORMAL_SCALE = 127  # normals travel as signed bytes
SHORT_INDEX = 65_536  # vertices that an index of two bytes can count
FIRST_CELL = 1 / 400  # of a mesh's diagonal: cells into which a too fine mesh is thinned
COARSER = 1.25  # by this the cells grow until the mesh is small enough


def encoded(array: np.ndarray) -> str:
    """Base64 of an array's bytes, little-endian."""
    return base64.b64encode(array.astype(array.dtype.newbyteorder("<")).tobytes()).decode("ascii")


def page_geometry(mesh: trimesh.Trimesh) -> dict[str, Any]:
    """`positions` float32 [m], `normals` int8 (x, y, z, 0), `indices`, `edges` float32 pairs of ends [m], `closed`."""
    mesh = thinned(mesh)
    normals = np.rint(corner_normals(mesh).reshape(-1, 3) * NORMAL_SCALE).astype(np.int64)
    corners = np.column_stack([np.asarray(mesh.faces).reshape(-1), normals])
    kept, indices = np.unique(corners, axis=0, return_inverse=True)
    index_type = np.dtype(np.uint16 if len(kept) <= SHORT_INDEX else np.uint32)
    sharp = mesh.face_adjacency_angles > np.radians(CREASE_ANGLE)
    return {
        "positions": encoded(np.asarray(mesh.vertices)[kept[:, 0]].astype(np.float32)),
        "normals": encoded(np.column_stack([kept[:, 1:], np.zeros(len(kept))]).astype(np.int8)),
        "indices": encoded(indices.reshape(-1).astype(index_type)),
        "index_bytes": index_type.itemsize,
        "edges": encoded(np.asarray(mesh.vertices)[mesh.face_adjacency_edges[sharp]].astype(np.float32)),
        "closed": bool(mesh.is_watertight),
    }


def thinned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh of at most 40,000 triangles that looks the same: vertices that share a small cell become one.

    Only for looking at; nothing is ever judged on it.
    """
    cell = float(np.linalg.norm(mesh.extents)) * FIRST_CELL if len(mesh.faces) > LARGEST_MESH else 0.0
    result = mesh
    while len(result.faces) > LARGEST_MESH:
        cells = np.floor((mesh.vertices - mesh.bounds[0]) / cell).astype(np.int64)
        _, cluster = np.unique(cells, axis=0, return_inverse=True)
        cluster = cluster.reshape(-1)
        sums = np.stack([np.bincount(cluster, weights=axis) for axis in mesh.vertices.T], axis=1)
        faces = cluster[mesh.faces]
        distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        faces = faces[distinct]
        _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
        result = trimesh.Trimesh(sums / np.bincount(cluster)[:, None], faces[np.sort(first)], process=False)
        cell *= COARSER
    return result


ASPECT = 4 / 3  # of the stage for which the first view is chosen
BALL_RADIUS = 0.0035  # [m] of a contact
EDGE = (0.42, 0.42, 0.44)  # sRGB of the surroundings' edges
MOVING: tuple[Role, ...] = ("object", "link", "fingertip", "base")


def check_same_bodies(drawings: Sequence[VisualScene]) -> None:
    """Refuse drawings of different bodies, which one page cannot show; InputError."""
    bodies = [[(id(part.mesh), part.role) for part in drawing.parts] for drawing in drawings]
    for index, other in enumerate(bodies):
        if other != bodies[0]:
            raise InputError(
                f"drawing {index} shows other bodies than drawing 0; expected the same meshes in the same order; "
                "write one page for each scene"
            )


def page_data(drawings: Sequence[VisualScene], *, camera: Camera | None = None) -> dict[str, Any]:
    """What `stage.js` draws of one or more drawings of the same bodies.

    `configurations` holds the poses (3 x 4 float32 of each body, world) and contacts [m] of each; `arrow` and `ball` are
    the geometries of the motion's arrow, as the first drawing has it, and of a contact. camera: where to look from at
    first, the best view of the first drawing unless given.
    """
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
        "camera": _camera(first, camera or choose_camera(first, aspect=ASPECT)),
    }


def _camera(drawing: VisualScene, camera: Camera) -> dict[str, Any]:
    """The camera as the page turns it: about a point near the object."""
    middle = np.concatenate([part.vertices_in_world() for part in drawing.with_role("object")]).mean(axis=0)
    distance = float((middle - camera.position) @ camera.forward)
    return {
        "target": (camera.position + distance * camera.forward).tolist(),
        "distance": distance,
        "azimuth": float(np.arctan2(-camera.forward[1], -camera.forward[0])),
        "elevation": float(np.arcsin(-camera.forward[2])),
        "tangent": TAN_HALF_HEIGHT,
    }


LARGEST_PAGE = 500  # configurations; more would make the page slow to open
OPACITY = 40  # [%] of the surroundings at first
LEGEND: dict[Role, str] = {
    "object": "object",
    "fingertip": "fingertips",
    "contact": "contacts",
    "arrow": "motion",
    "environment": "surroundings",
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


def write_page(
    drawings: Sequence[VisualScene], path: Path | str, *, title: str, figures: Sequence[Figures], subtitle: str = ""
) -> Path:
    """Writes the page: a 3-D view, and a table in which a configuration is chosen, verified ones first.

    Args:
        drawings: the configurations, of the same bodies in the same order (as `drawing.drawings` returns them). Their
            place in this sequence is the number that the page gives them. At most 500 are shown.
        path: of the HTML file.
        title: plain text; whatever stands in it is shown, never interpreted.
        figures: the numbers of each drawing; a value that one of them lacks is shown as a dash.
        subtitle: plain text, as the title.

    Raises:
        InputError: no drawing, not one entry of figures for each, or drawings of different bodies.
        OutputError: the file cannot be written.
    """
    _check(drawings, figures)
    order = sorted(range(len(drawings)), key=lambda index: not figures[index].success)[:LARGEST_PAGE]
    if len(order) < len(drawings):
        subtitle = f"{subtitle} The first {len(order)} of {len(drawings)} are shown.".strip()
    names = list(dict.fromkeys(name for each in figures for name in each.values))
    page = filled_template(
        "page.html",
        ("page.css",),
        ("stage.js", "page.js"),
        title=escape(title),
        subtitle=escape(subtitle),
        last=len(order) - 1,
        opacity=OPACITY,
        legend=legend(LEGEND),
        head=_head(names),
        rows="\n".join(_row(index, figures[index], names) for index in order),
        data=json_text(page_data([drawings[index] for index in order])),
    )
    return write_text(page, path)


def _check(drawings: Sequence[VisualScene], figures: Sequence[Figures]) -> None:
    if not drawings:
        raise InputError("a page of no configurations was asked for; expected at least one")
    if len(figures) != len(drawings):
        raise InputError(
            f"figures of {len(figures)} configurations were given for {len(drawings)}; expected one entry for each"
        )
    check_same_bodies(drawings)


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
