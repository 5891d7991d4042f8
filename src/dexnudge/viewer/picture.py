"""Pictures of visual scenes by ray tracing on the CPU: neither GPU nor display is needed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from dexnudge.errors import InputError, check_path, quote, writing
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.viewer.camera import Camera, choose_camera
from dexnudge.viewer.ray_scene import ray_scene
from dexnudge.viewer.shading_kernel import Pixels, shade_picture, trace_picture
from dexnudge.viewer.trace_kernel import Surface, View, parallel_launch
from dexnudge.viewer.visual_scene import VisualScene

SIZE = (1280, 960)  # pixels, width and height
LIGHT_TURN = -50.0  # [deg] of the key light to the left of the camera, so that shadows show shape
LIGHT_ELEVATION = 55.0  # [deg]
GAP = 6  # pixels of white between pictures that stand side by side
TITLE_HEIGHT = 0.055  # of a picture's height
TITLE_COLOUR = (45, 52, 62)  # sRGB


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
    pixels.surface, pixels.light, colour = (
        wp.empty(width * height, dtype=kind, device="cpu") for kind in (Surface, wp.vec2, wp.vec3)
    )
    parallel_launch(trace_picture, width * height, [geometry, view, pixels])
    parallel_launch(shade_picture, width * height, [geometry, view, pixels, colour])
    return _to_bytes(colour.numpy().reshape(height, width, 3))


def render_png(scene: VisualScene, path: Path | str, *, size: tuple[int, int] = SIZE) -> Path:
    """Write the picture of a visual scene.

    Raises:
        InputError: a path that does not end in .png.
        OutputError: the file cannot be written.
    """
    check_png(path)
    return write_png(render_array(scene, size=size), path)


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
    """Return the sRGB bytes (IEC 61966-2-1) of linear light."""
    value = np.clip(linear, 0.0, 1.0)
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
