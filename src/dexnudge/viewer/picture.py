"""Pictures of a drawing, ray-cast on the CPU: no GPU, no display, no system packages."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from dexnudge.errors import InputError, OutputError
from dexnudge.geometry.warp_runtime import wp
from dexnudge.viewer.camera import Camera
from dexnudge.viewer.drawing import Drawing
from dexnudge.viewer.parallel_launch import parallel_launch
from dexnudge.viewer.ray_scene import ray_scene
from dexnudge.viewer.shading_kernel import shade_picture, trace_picture
from dexnudge.viewer.trace_kernel import View
from dexnudge.viewer.viewpoint import choose_camera

SIZE = (1280, 960)  # pixels, width and height
LIGHT_TURN = -50.0  # [deg] of the key light to the left of the camera, so that shadows show shape
LIGHT_ELEVATION = 55.0  # [deg]


def render_array(
    drawing: Drawing,
    *,
    size: tuple[int, int] = SIZE,
    camera: Camera | None = None,
    glass: Sequence[Bool[np.ndarray, " face"]] | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """The picture as sRGB bytes. The same drawing gives the same bytes on every run and number of cores.

    Args:
        drawing: what to show.
        size: width and height in pixels.
        camera: where to look from; None looks for the best of many directions.
        glass: of each part of the surroundings, the triangles to look through; None for what hides object or hand.

    Raises:
        InputError: a size below one pixel.
    """
    width, height = size
    if width < 1 or height < 1:
        raise InputError(f"a picture of {width} x {height} pixels was asked for; expected at least 1 x 1")
    aspect = width / height
    camera = camera or choose_camera(drawing, aspect=aspect)
    scene = ray_scene(drawing, camera, aspect=aspect, hiding=glass)
    view = _view(camera, size)
    count = width * height
    face, depth, opacity = (wp.empty(count, dtype=kind, device="cpu") for kind in (int, float, float))
    normal, colour = (wp.empty(count, dtype=wp.vec3, device="cpu") for _ in range(2))
    light = wp.empty(count, dtype=wp.vec2, device="cpu")
    parallel_launch(trace_picture, count, [scene.geometry, view, face, depth, normal, opacity, light])
    parallel_launch(shade_picture, count, [scene.geometry, view, face, depth, normal, opacity, light, colour])
    return _to_bytes(colour.numpy().reshape(height, width, 3))


def render_png(
    drawing: Drawing, path: Path | str, *, size: tuple[int, int] = SIZE, camera: Camera | None = None
) -> Path:
    """Writes the picture of a drawing.

    Raises:
        OutputError: the file cannot be written.
    """
    return write_png(render_array(drawing, size=size, camera=camera), path)


def write_png(picture: UInt8[np.ndarray, "height width 3"], path: Path | str) -> Path:
    """Writes sRGB bytes as PNG.

    Raises:
        OutputError: the file cannot be written.
    """
    path = Path(path)
    try:
        Image.fromarray(picture).save(path, format="PNG", optimize=False)
    except OSError as error:
        raise OutputError(
            f"the picture {path} cannot be written: {error}; expected a folder that exists and is writable"
        ) from error
    return path


def _view(camera: Camera, size: tuple[int, int]) -> Any:
    # A Warp struct is no type that a checker knows.
    azimuth = np.arctan2(-camera.forward[1], -camera.forward[0]) + np.radians(LIGHT_TURN)
    level, rise = np.cos(np.radians(LIGHT_ELEVATION)), np.sin(np.radians(LIGHT_ELEVATION))
    view = View()
    view.position = wp.vec3(*camera.position)
    view.right = wp.vec3(*(camera.right * camera.tan_width))
    view.up = wp.vec3(*(camera.up * camera.tan_height))
    view.forward = wp.vec3(*camera.forward)
    view.light = wp.vec3(level * np.cos(azimuth), level * np.sin(azimuth), rise)
    view.width, view.height = size
    return view


def _to_bytes(linear: Float[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    """sRGB bytes (IEC 61966-2-1) of linear light."""
    value = np.clip(linear, 0.0, 1.0)
    return np.rint(255 * np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)).astype(
        np.uint8
    )
