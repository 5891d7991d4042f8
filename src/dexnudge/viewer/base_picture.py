"""A map of where an arm may stand, from above: places coloured by share, the surroundings below them, object and motion."""

from collections.abc import Callable

import numpy as np
import trimesh
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from dexnudge.scenes.scene import Scene

SIZE, FINER = 560, 2  # pixels of a map's side, and how much finer it is drawn
MARGIN, HEADING, LEGEND = 56, 44, 64  # pixels beside, above and below
CELL = 0.86  # of a place's side that is coloured
ARROW = 0.25  # [m] at least of the arrow, so that it is seen
PAPER, INK, GREY, GROUND, OBJECT = "#ffffff", "#1f2933", "#9aa5b1", "#e4e7eb", "#e07b39"
SHARES = np.array([[236, 240, 244], [172, 208, 218], [84, 160, 178], [28, 104, 134], [10, 52, 84]])  # sRGB, from 0 to 1
SOUTH_EAST = np.array([1.0, -1.0])
TICK = 0.3  # [m] between two numbers at a map's side


def base_picture(
    scene: Scene,
    x: Float[np.ndarray, " column"],
    y: Float[np.ndarray, " row"],
    heights: Float[np.ndarray, " height"],
    share: Float[np.ndarray, "height row column"],
    best: tuple[int, int, int] | None,
    arm: str,
) -> UInt8[np.ndarray, "pixel_row pixel_column 3"]:
    """Return the picture as sRGB bytes, a map for each height side by side.

    x, y: of the places [m, world]. heights: over the object's underside [m]. share: NaN where the surroundings stand. best:
    place that is marked, as an index of `share`.
    """
    panels = []
    for index, height in enumerate(heights.tolist()):
        title = f"{arm}: share of configurations that it reaches from there"
        title += f", base {height:+.2f} m" if len(heights) > 1 or height else ""
        mark = best[1:] if best and best[0] == index else None
        panels.append(_panel(scene, x, y, share[index], mark, title))
    return np.concatenate(panels, axis=1)


def _panel(
    scene: Scene,
    x: Float[np.ndarray, " column"],
    y: Float[np.ndarray, " row"],
    share: Float[np.ndarray, "row column"],
    mark: tuple[int, int] | None,
    title: str,
) -> UInt8[np.ndarray, "pixel_row pixel_column 3"]:
    step = float(x[1] - x[0])
    corner, metres = np.array([x[0] - step / 2, y[-1] + step / 2]), step * len(x)
    fine = FINER * SIZE / metres
    offset = FINER * np.array([MARGIN, HEADING], dtype=float)
    side = FINER * SIZE
    sheet = Image.new("RGB", (side + 2 * FINER * MARGIN, side + FINER * (HEADING + LEGEND)), PAPER)
    whole = ImageDraw.Draw(sheet)

    def at(places: Float[np.ndarray, "place axis"]) -> list[tuple[float, float]]:
        """Pixels of places [m]; y goes up."""
        pixels = (places[:, :2] - corner) * (fine, -fine)
        return [(float(column), float(row)) for column, row in pixels]

    ground = Image.new("RGB", (side, side), PAPER)
    draw = ImageDraw.Draw(ground)
    surroundings = scene.environment_mesh
    for triangle in surroundings.vertices[surroundings.faces[np.abs(surroundings.face_normals[:, 2]) > 1e-3]]:
        draw.polygon(at(triangle), fill=GROUND, outline=GROUND)
    for row, column in np.ndindex(share.shape):
        _cell(draw, at(np.array([[x[column], y[row]]]))[0], CELL * step * fine / 2, share[row, column])
    body = scene.object_in_world()
    draw.polygon(at(_outline(body)), fill=OBJECT, outline=INK, width=FINER)
    middle = body.bounds.mean(axis=0)
    _arrow(draw, at, middle, middle + max(ARROW, scene.motion_length) * scene.motion)
    if mark:
        place, half = np.array([x[mark[1]], y[mark[0]]]), 0.62 * step
        box = at(np.array([place - half * SOUTH_EAST, place + half * SOUTH_EAST]))
        draw.ellipse([*box[0], *box[1]], outline=OBJECT, width=3 * FINER)
        facing = middle[:2] - place
        ahead = place + 1.2 * step * facing / max(float(np.linalg.norm(facing)), 1e-9)
        draw.line(at(np.array([place, ahead])), fill=OBJECT, width=2 * FINER)
    sheet.paste(ground, (int(offset[0]), int(offset[1])))
    whole.rectangle([*offset, *(offset + side)], outline=GREY, width=FINER)
    _scales(whole, corner, metres, fine, offset)
    whole.text((offset[0], FINER * 14), title, fill=INK, font=_font(13))
    _legend(whole, FINER * (HEADING + SIZE + 30), mark)
    return np.asarray(sheet.resize((sheet.width // FINER, sheet.height // FINER), Image.Resampling.LANCZOS))


def _cell(draw: ImageDraw.ImageDraw, middle: tuple[float, float], half: float, share: float) -> None:
    column, row = middle
    box = (column - half, row - half, column + half, row + half)
    if np.isnan(share):  # the surroundings stand there
        draw.line([box[0], box[1], box[2], box[3]], fill=GREY, width=FINER)
        draw.line([box[0], box[3], box[2], box[1]], fill=GREY, width=FINER)
    else:
        draw.rectangle(box, fill=colour(share))


def colour(share: float) -> tuple[int, int, int]:
    """Return the sRGB colour of a share: the darker, the larger."""
    red, green, blue = (
        round(float(np.interp(share, np.linspace(0, 1, len(SHARES)), column))) for column in SHARES.T.astype(float)
    )
    return red, green, blue


def _outline(mesh: trimesh.Trimesh) -> Float[np.ndarray, "corner 2"]:
    """Return the convex outline of a mesh from above."""
    from scipy.spatial import ConvexHull

    places = np.asarray(mesh.vertices[:, :2])
    return places[ConvexHull(places).vertices]


def _arrow(
    draw: ImageDraw.ImageDraw,
    at: Callable[[Float[np.ndarray, "place axis"]], list[tuple[float, float]]],
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
) -> None:
    way = (end - start)[:2]
    length = float(np.linalg.norm(way))
    if length < 1e-6:  # straight up
        return
    ahead, aside = way / length, np.array([-way[1], way[0]]) / length
    draw.line(at(np.array([start[:2], end[:2] - 0.03 * ahead])), fill=INK, width=2 * FINER)
    tip = end[:2]
    draw.polygon(at(np.array([tip, tip - 0.05 * ahead + 0.022 * aside, tip - 0.05 * ahead - 0.022 * aside])), fill=INK)


def _scales(
    draw: ImageDraw.ImageDraw,
    corner: Float[np.ndarray, "2"],
    metres: float,
    fine: float,
    offset: Float[np.ndarray, "2"],
) -> None:
    """Numbers [m, world] below and beside the map."""
    font = _font(11)
    for value in TICK * np.arange(np.ceil(corner[0] / TICK), (corner[0] + metres) / TICK):
        column = offset[0] + (value - corner[0]) * fine
        draw.text((column, offset[1] + FINER * (SIZE + 5)), f"{value:.1f}", fill=INK, font=font, anchor="ma")
    for value in TICK * np.arange(np.ceil((corner[1] - metres) / TICK), corner[1] / TICK):
        row = offset[1] + (corner[1] - value) * fine
        draw.text((offset[0] - FINER * 6, row), f"{value:.1f}", fill=INK, font=font, anchor="rm")
    draw.text(
        (offset[0] + FINER * (SIZE + 6), offset[1] + FINER * (SIZE + 5)), "x [m]", fill=INK, font=font, anchor="la"
    )
    draw.text((offset[0] - FINER * 6, offset[1] - FINER * 4), "y [m]", fill=INK, font=font, anchor="rd")


def _legend(draw: ImageDraw.ImageDraw, top: int, mark: tuple[int, int] | None) -> None:
    font, left, width, high = _font(12), FINER * MARGIN, FINER * 110, FINER * 14
    for pixel in range(width):
        draw.line([left + pixel, top, left + pixel, top + high], fill=colour(pixel / (width - 1)))
    left += width + FINER * 6
    entries = ["0 to 100 %", "taken by the surroundings", "motion", "best place"]
    for entry in entries[: 4 if mark else 3]:
        middle, end = top + high // 2, left + high
        if entry == "taken by the surroundings":
            draw.line([left, top, end, top + high], fill=GREY, width=FINER)
            draw.line([left, top + high, end, top], fill=GREY, width=FINER)
        elif entry == "motion":
            draw.line([left, middle, end, middle], fill=INK, width=2 * FINER)
            draw.polygon([(end + 8, middle), (end - 6, middle - 7), (end - 6, middle + 7)], fill=INK)
        elif entry == "best place":
            draw.ellipse([left, top, end, top + high], outline=OBJECT, width=3 * FINER)
        left += 0 if entry == "0 to 100 %" else high + FINER * 8
        draw.text((left, top), entry, fill=INK, font=font)
        left += round(draw.textlength(entry, font=font)) + FINER * 16


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(FINER * size)
