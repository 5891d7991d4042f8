"""Pictures of visual scenes, packed for the ray kernels, by ray tracing on the CPU: neither GPU nor display is needed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Shaped, UInt8
from PIL import Image, ImageDraw, ImageFont

from dexnudge.errors import InputError, check_path, quote, writing
from dexnudge.geometry.warp_runtime import WarpStruct, launch_in_threads, wp
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.jobs.processes import thread_count, trim_memory
from dexnudge.viewer.camera import Camera, choose_camera, hiding_faces
from dexnudge.viewer.shading_kernel import LOOKED_AROUND, Pixels, shade_picture, trace_picture
from dexnudge.viewer.trace_kernel import TRIANGLE, Geometry, Surface, Triangle, View, warp_mesh
from dexnudge.viewer.visual_scene import (
    CONTACT_RADIUS,
    CREASE_ANGLE,
    PALETTE,
    ROBOT,
    SEE_THROUGH,
    Colour,
    Part,
    Role,
    VisualScene,
    legend,
)

LARGEST_FAN = 128  # triangles at one vertex beyond which its corners stay flat: the cost grows with the square
MERGE_DIGITS = 6  # vertices closer than a micrometre are one


@cached_per_instance
def corner_normals(mesh: trimesh.Trimesh) -> Float[np.ndarray, "face 3 3"]:
    """Return the unit normal at each corner of each triangle, mesh frame.

    The mean, weighted by area, over the triangles that meet in the corner's vertex and bend less than 35 deg from its own.
    """
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    weighted = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(weighted, axis=1, keepdims=True)
    flat = weighted / np.where(sizes > 0, sizes, 1.0)

    _, merged = np.unique(np.round(mesh.vertices, MERGE_DIGITS), axis=0, return_inverse=True)
    vertex = merged.reshape(-1)[np.asarray(mesh.faces)].reshape(-1)
    order = np.argsort(vertex, kind="stable")
    starts = np.flatnonzero(np.diff(vertex[order], prepend=-1))
    fans = np.diff(np.append(starts, len(order)))
    total = np.repeat(weighted, 3, axis=0)
    for size in np.unique(fans[(fans > 1) & (fans <= LARGEST_FAN)]):
        corners = order[starts[fans == size][:, None] + np.arange(size)]  # (vertex, size)
        own, area = flat[corners // 3], weighted[corners // 3]
        together = np.einsum("vic,vjc->vij", own, own) > np.cos(np.radians(CREASE_ANGLE))
        total[corners] = np.einsum("vij,vjc->vic", together, area)
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    smooth = np.where(lengths > 0, total / np.where(lengths > 0, lengths, 1.0), [0.0, 0.0, 1.0])
    return smooth.reshape(-1, 3, 3)


GLOSS: dict[Role, float] = {"object": 0.10, "link": 0.06, "fingertip": 0.08}  # strength of the highlight
GLASS_OPACITY = 0.18  # of a wall or base that hides object or hand
EDGE_OPACITY = 0.75  # of the lines along the edges of such a wall
EDGE_WIDTH = 0.0011  # of the distance to the camera: about two pixels of a picture 960 high
EDGE_COLOUR = (0.45, 0.50, 0.57)  # sRGB


Triangles = Shaped[np.ndarray, " face"]  # of type TRIANGLE


def linear_colour(srgb: Colour | Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Return the linear light of an sRGB colour (IEC 61966-2-1)."""
    value = np.asarray(srgb)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def ray_scene(
    scene: VisualScene, camera: Camera, *, hiding: Sequence[Bool[np.ndarray, " face"]] | None = None
) -> tuple[WarpStruct, list[wp.Mesh]]:
    """Pack everything solid, ghosts and what hides the subject as glass, and contacts as markers that show through.

    Markers are contacts, supports, obstacles and arrows that are parts. Returns the kernels' `Geometry`, and the trees that
    it refers to by number, which must outlive it.

    hiding: triangles that are glass, as `hiding_faces` returns them, which is asked unless they are given. What was never
        seen is glass in any case.
    """
    casting = [_triangles(part) for part in (*scene.with_role("object", "link", "fingertip"), scene.arrow())]
    solid, blocking = list(casting), list[Triangles]()
    glass = [np.zeros(0, TRIANGLE), *(_triangles(part) for part in scene.with_role("ghost"))]
    found = hiding_faces(scene, camera) if hiding is None else hiding
    for part, hides in zip(scene.with_role(*SEE_THROUGH), found, strict=True):
        placed, mesh = _triangles(part), part.mesh_in_world()
        see_through = hides | (part.role == "unseen")
        (casting if part.role in ROBOT else blocking).append(placed[~see_through])
        # The back of a closed body cannot be seen, and shows as soon as its front is glass; an open one has two sides.
        towards = np.einsum("ij,ij->i", mesh.face_normals, camera.position - mesh.triangles_center) > 0
        facing = towards if part.mesh.is_watertight else np.ones_like(towards)
        solid.append(placed[facing & ~see_through])
        pane = placed[facing & see_through]
        pane["colour"] = linear_colour(PALETTE["unseen" if part.role == "unseen" else "glass"])
        glass += [pane] if part.role == "unseen" else [pane, _edge_lines(mesh, see_through, camera)]
    ball = trimesh.creation.icosphere(subdivisions=2, radius=CONTACT_RADIUS)
    places = [trimesh.transformations.translation_matrix(point) for point in scene.contacts]
    markers = [_triangles(Part("contact", "contact", ball, T_world_ball)) for T_world_ball in places]
    markers += [_triangles(part) for part in scene.with_role("support", "obstacle", "arrow")]
    seen = {"solid": solid, "glass": glass, "markers": [np.zeros(0, TRIANGLE), *markers]}
    geometry, trees = Geometry(), []
    for name, group in {**seen, "blocking": [*casting, *blocking], "casting": casting}.items():
        corners = np.concatenate([each["corners"] for each in group])
        if len(corners):
            trees.append(warp_mesh(corners))
            setattr(geometry, name, trees[-1].id)
    geometry.first_glass = sum(map(len, solid))
    geometry.first_marker = geometry.first_glass + sum(map(len, glass))
    table = np.concatenate([*solid, *glass, *seen["markers"]])
    geometry.triangles = wp.array(table, dtype=Triangle, device="cpu", copy=False)
    return geometry, trees


def _triangles(part: Part) -> Triangles:
    triangles = np.zeros(len(part.mesh.faces), TRIANGLE)
    triangles["corners"] = part.vertices_in_world()[part.mesh.faces]
    triangles["normals"] = corner_normals(part.mesh) @ np.asarray(part.T_world_part)[:3, :3].T
    triangles["colour"] = linear_colour(part.colour)
    triangles["gloss"] = GLOSS.get(part.role, 0.0)
    triangles["opacity"] = GLASS_OPACITY
    return triangles


def _edge_lines(mesh: trimesh.Trimesh, which: Bool[np.ndarray, " face"], camera: Camera) -> Triangles:
    """Return ribbons that face the camera along the creases of some triangles, so that glass keeps its shape."""
    sharp = mesh.face_adjacency_angles > np.radians(CREASE_ANGLE)
    sharp &= which[mesh.face_adjacency].any(axis=1)
    ends = np.asarray(mesh.vertices)[mesh.face_adjacency_edges[sharp]]
    towards = camera.position - ends
    distance = np.linalg.norm(towards, axis=2, keepdims=True)
    side = np.cross((ends[:, 1] - ends[:, 0])[:, None], towards)
    side /= np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-12)
    side *= distance * EDGE_WIDTH / 2
    (a, b), (c, d) = np.moveaxis(ends - side, 1, 0), np.moveaxis(ends + side, 1, 0)
    corners = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    ribbons = np.zeros(len(corners), TRIANGLE)
    ribbons["corners"], ribbons["normals"] = corners, -camera.forward
    ribbons["colour"], ribbons["opacity"] = linear_colour(EDGE_COLOUR), EDGE_OPACITY
    return ribbons


SIZE = (1280, 960)  # pixels, width and height
BAND = 2**16  # pixels that are made at once: each takes 56 bytes until it is shown
LIGHT_TURN = -50.0  # [deg] of the key light to the left of the camera, so that shadows show shape
LIGHT_ELEVATION = 55.0  # [deg]
GAP = 6  # pixels of white between pictures that stand side by side
TITLE_HEIGHT = 0.055  # of a picture's height
LEGEND_HEIGHT = 0.021  # of a picture's height: the letters of its legend
TITLE_COLOUR = (45, 52, 62)  # sRGB
GOOD, BAD, NEUTRAL = (22, 122, 66), (190, 30, 40), (40, 44, 52)  # sRGB, of a verdict, and of a text that is none
HEAD_HEIGHT = 40  # pixels of the line above a sheet, and the share of it that the letters have at most
LETTERS = 0.6


def render_array(
    scene: VisualScene,
    *,
    size: tuple[int, int] = SIZE,
    camera: Camera | None = None,
    glass: Sequence[Bool[np.ndarray, " face"]] | None = None,
    light_every: int = 2,
) -> UInt8[np.ndarray, "height width 3"]:
    """Return the picture as sRGB bytes. The same scene gives the same bytes on every run and number of cores.

    Args:
        scene: what to show.
        size: width and height in pixels.
        camera: where to look from; None looks for the best of many directions.
        glass: the triangles to look through, as `hiding_faces` returns them; None for what hides object or hand.
        light_every: pixels between those whose light is measured; more is faster, and shadows are softer.

    Raises:
        InputError: a size below one pixel.
    """
    width, height = size
    if width < 1 or height < 1:
        raise InputError(f"a picture of {width} x {height} pixels was asked for; expected at least 1 x 1")
    camera = camera or choose_camera(scene, aspect=width / height)
    geometry, _trees = ray_scene(scene, camera, hiding=glass)
    view, pixels = _view(camera, size, light_every), Pixels()
    rows, around = min(height, max(1, BAND // width)), LOOKED_AROUND * light_every
    pixels.rows = min(height, rows + 2 * around)
    pixels.surface, pixels.light = (
        wp.empty(pixels.rows * width, dtype=kind, device="cpu") for kind in (Surface, wp.vec2)
    )
    colour = wp.empty(rows * width, dtype=wp.vec3, device="cpu")
    picture = np.empty((height, width, 3), dtype=np.uint8)
    traced, threads = 0, thread_count()
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        ahead = min(bottom + around, height)
        inputs, counts = [geometry, view, pixels], [(ahead - traced) * width, (bottom - top) * width]
        launch_in_threads(trace_picture, counts[:1], [traced, *inputs], device="cpu", threads=threads)
        launch_in_threads(shade_picture, counts[1:], [top, *inputs, colour], device="cpu", threads=threads)
        picture[top:bottom] = _to_bytes(colour.numpy()[: counts[1]].reshape(-1, width, 3))
        traced = ahead
    return picture


def render_png(scene: VisualScene, path: Path | str, *, size: tuple[int, int] | None = None) -> Path:
    """Write the picture of a visual scene with a legend, 1280 x 960 pixels unless a size is given.

    Raises:
        InputError: a path that does not end in .png.
        OutputError: the file cannot be written.
    """
    check_png(path)
    picture = render_array(scene, size=size or SIZE)
    trim_memory()  # of what was traced
    return write_png(with_legend(picture, legend([scene])), path)


def with_legend(
    picture: UInt8[np.ndarray, "height width 3"], shown: Mapping[str, Colour]
) -> UInt8[np.ndarray, "height width 3"]:
    """Return the picture with a row at its lower edge of what is shown: a square of its colour, and its name."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    side = max(1.0, LEGEND_HEIGHT * image.height)
    font = ImageFont.load_default(side)
    widths = [2.5 * side + font.getlength(name) for name in shown]
    shrunk = min(1.0, image.width / (sum(widths) + side))
    font, side = ImageFont.load_default(max(1.0, shrunk * side)), shrunk * side
    x, y = side, image.height - side
    for (name, colour), width in zip(shown.items(), widths, strict=True):
        fill = tuple(round(255 * channel) for channel in colour)
        draw.rectangle((x, y - 0.9 * side, x + 0.8 * side, y - 0.1 * side), fill=fill, outline=TITLE_COLOUR)
        draw.text((x + 1.2 * side, y - side / 2), name, fill=TITLE_COLOUR, font=font, anchor="lm")
        x += shrunk * width
    return np.asarray(image)


def write_png(picture: UInt8[np.ndarray, "height width 3"], path: Path | str) -> Path:
    """Write sRGB bytes as PNG.

    Raises:
        InputError: a path that does not end in .png.
        OutputError: the file cannot be written.
    """
    check_png(path)
    path = Path(path)
    with writing(f"the picture {path}"):
        Image.fromarray(picture).save(path, format="PNG", optimize=False)
    return path


def check_png(path: Path | str) -> None:
    """Refuse a path that does not end in .png; InputError."""
    check_path("path", path)
    if Path(path).suffix.lower() != ".png":
        raise InputError(f"`path` is {quote(str(path))}; expected a name that ends in .png; pictures are PNG files")


def _view(camera: Camera, size: tuple[int, int], grid: int) -> WarpStruct:
    azimuth = camera.azimuth + np.radians(LIGHT_TURN)
    level, rise = np.cos(np.radians(LIGHT_ELEVATION)), np.sin(np.radians(LIGHT_ELEVATION))
    view = View()
    view.position = wp.vec3(*camera.position)
    view.right = wp.vec3(*(camera.right * camera.tan_width))
    view.up = wp.vec3(*(camera.up * camera.tan_height))
    view.forward = wp.vec3(*camera.forward)
    view.light = wp.vec3(level * np.cos(azimuth), level * np.sin(azimuth), rise)
    view.width, view.height, view.grid = *size, grid
    return view


def _to_bytes(linear: Float[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    """Return the sRGB bytes (IEC 61966-2-1) of linear light, which is clipped."""
    value = np.clip(linear, 0.0, 1.0, out=linear)
    bright = value ** (1 / 2.4)
    bright *= 1.055
    bright -= 0.055
    np.multiply(value, 12.92, out=bright, where=value <= 0.0031308)
    bright *= 255
    return np.rint(bright, out=bright).astype(np.uint8)


def arrange(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]], titles: Sequence[str], *, columns: int
) -> UInt8[np.ndarray, "sheet_height sheet_width 3"]:
    """Return one or more pictures of one size side by side, row by row, each with its title in the corner; sRGB bytes."""
    height, width = pictures[0].shape[:2]
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * (width + GAP) - GAP, rows * (height + GAP) - GAP), "white")
    font = ImageFont.load_default(TITLE_HEIGHT * height)
    for index, (picture, title) in enumerate(zip(pictures, titles, strict=True)):
        corner = (index % columns * (width + GAP), index // columns * (height + GAP))
        sheet.paste(Image.fromarray(picture), corner)
        margin = round(TITLE_HEIGHT * height / 2)
        ImageDraw.Draw(sheet).text((corner[0] + margin, corner[1] + margin), title, fill=TITLE_COLOUR, font=font)
    return np.asarray(sheet)


def headed(
    sheet: UInt8[np.ndarray, "height width 3"], text: str, colour: tuple[int, int, int]
) -> UInt8[np.ndarray, "sheet_height width 3"]:
    """Return a sheet with a line of text above it, as large as fits; sRGB bytes."""
    height, width = sheet.shape[:2]
    image = Image.new("RGB", (width, height + HEAD_HEIGHT), "white")
    image.paste(Image.fromarray(sheet), (0, HEAD_HEIGHT))
    margin, size = round((1 - LETTERS) / 2 * HEAD_HEIGHT), LETTERS * HEAD_HEIGHT
    wide = ImageFont.load_default(size).getlength(text)
    font = ImageFont.load_default(max(1.0, min(size, size * (width - 2 * margin) / max(wide, 1.0))))
    ImageDraw.Draw(image).text((margin, HEAD_HEIGHT / 2), text, fill=colour, font=font, anchor="lm")
    return np.asarray(image)
