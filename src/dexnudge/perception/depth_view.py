"""Depth views: what a depth camera measured, where it stood, and which pixels are the object; and its PNG files.

Camera frame (OpenCV, ROS optical frame): x right, y down, z forward along the optical axis. The centre of the pixel in
column u and row v has image coordinates (u, v): x = (u - cx) z / fx, y = (v - cy) z / fy.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt16
from PIL import Image

from dexnudge.errors import SceneError, quote, what_failed
from dexnudge.geometry.rigid import rigid_transform

MAX_PIXELS = 64_000_000  # of one image; the largest depth cameras have 4 million
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER = 33  # bytes: signature, then the chunk IHDR with its length, name and check sum
GREY, COLOUR, PALETTE, ALPHA = 0, 2, 3, 4  # colour types of PNG; ALPHA is added to GREY or COLOUR
KINDS = {
    GREY: "grey",
    COLOUR: "colour",
    PALETTE: "palette",
    GREY + ALPHA: "grey with alpha",
    COLOUR + ALPHA: "colour with alpha",
}
DEPTH_BITS = 16


def read_depth(path: Path, *, width: int, height: int) -> UInt16[np.ndarray, "height width"]:
    """Return a depth image in its own unit; 0 = not measured.

    Raises:
        SceneError: no PNG of 16 bits and one channel, another size, truncated, or nothing measured.
    """
    bits, kind = _announced(path, width=width, height=height)
    if kind != GREY or bits != DEPTH_BITS:
        remedy = "is it the colour picture?" if kind != GREY else "eight bits hold 255 steps of depth only"
        raise SceneError(
            f"{path}: has {bits} bits, {KINDS.get(kind, kind)}; expected a depth image of 16 bits, grey; {remedy}; write "
            "depth as 16-bit PNG, in millimetres for example"
        )
    depth = _decoded(path, (width, height)).astype(np.uint16)
    if not depth.any():
        raise SceneError(f"{path}: no pixel is measured (all are 0); expected depth; leave this view out")
    return depth


def read_mask(path: Path, *, width: int, height: int) -> Bool[np.ndarray, "height width"]:
    """Return a mask: pixels that are not zero in any channel but alpha.

    Raises:
        SceneError: no PNG, another size, or truncated.
    """
    _, kind = _announced(path, width=width, height=height)
    pixels = _decoded(path, (width, height))
    colours = pixels.reshape(height, width, -1)
    return np.asarray((colours[..., :-1] if kind & ALPHA else colours).any(axis=-1))


def _announced(path: Path, *, width: int, height: int) -> tuple[int, int]:
    """Return bits and colour type from a PNG's header; SceneError for another size than the camera's."""
    expected = f"expected a PNG of {width} x {height}"
    try:
        if not path.is_file():  # no pipe, which would keep us waiting
            raise SceneError(f"{path}: no such file; {expected}")
        with path.open("rb") as file:
            header = file.read(HEADER)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({what_failed(error)}); {expected}") from error
    if header[:8] != PNG_SIGNATURE or header[12:16] != b"IHDR" or len(header) < HEADER:
        raise SceneError(f"{path}: is no PNG; {expected}; convert it without loss")
    found = struct.unpack(">II", header[16:24])
    if found != (width, height):
        raise SceneError(
            f"{path}: has {found[0]} x {found[1]} pixels; expected {width} x {height}, as its camera says; correct "
            "`width` and `height`, and scale `fx`, `fy`, `cx`, `cy` with them, or resize the image without interpolation"
        )
    return header[24], header[25]


def _decoded(path: Path, size: tuple[int, int]) -> np.ndarray:
    try:
        with Image.open(path, formats=("PNG",)) as image:
            if image.size == size:
                return np.array(image)
        detail = "it announces its size twice"
    except (OSError, SyntaxError, ValueError, struct.error, Image.DecompressionBombError) as error:
        detail = str(error)
    raise SceneError(f"{path}: cannot be read as PNG ({detail}); the file is truncated or damaged")


UNSCALED = "scale depth (`depth_unit`), not the camera"
NEAREST, FARTHEST = 0.02, 20.0  # [m] between which the median depth of a view of a workplace lies
# [m], [1/m], [m]: a + b (z - c)^2, Nguyen, Izadi and Lovell, Modeling Kinect sensor noise, 3DIMPVT 2012, equation 3.
AXIAL_NOISE = (0.0012, 0.0019, 0.4)
WIDEST_IMAGE, NARROWEST_IMAGE = 20.0, 0.005  # width over focal length: fields of view of 169 and 0.3 degrees


@dataclass(frozen=True, eq=False)
class DepthView:
    """One depth image and its camera.

    `depth` [m] lies along the optical axis; 0 = not measured (NaN and infinity, which ROS writes, become 0). `fx`, `fy`,
    `cx`, `cy` [px]. `T_world_camera`: rigid. `mask`: the object's pixels, or None where they are not known. `assumed`:
    pixels whose depth was not measured but completed. `name`: what messages call the view.

    Raises:
        SceneError: arrays of other shapes, nothing measured, depth that is negative or no workplace's, intrinsics that
            no camera has, or a transform that is not rigid.
    """

    depth: Float[np.ndarray, "height width"]
    fx: float
    fy: float
    cx: float
    cy: float
    T_world_camera: Float[np.ndarray, "4 4"]
    mask: Bool[np.ndarray, "height width"] | None = None
    assumed: Bool[np.ndarray, "height width"] | None = None
    name: str = "view"

    def __post_init__(self) -> None:
        depth = np.array(self.depth, dtype=np.float32)
        if depth.ndim != 2 or not depth.size or depth.size > MAX_PIXELS:
            raise SceneError(f"{self.name}: depth has shape {depth.shape}; expected (height, width)")
        depth[~np.isfinite(depth)] = 0.0
        measured = depth != 0
        if not measured.any():
            raise SceneError(f"{self.name}: no pixel is measured (all are 0 or NaN); expected depth; leave it out")
        least, median = float(depth.min()), float(np.median(depth[measured]))
        if least < 0 or not NEAREST <= median <= FARTHEST:
            found = f"is negative, {least:g} m" if least < 0 else f"is {median:g} m in the median"
            raise SceneError(
                f"{self.name}: depth {found}; expected {NEAREST:g} to {FARTHEST:g} m along the optical axis, 0 = not "
                "measured; is `depth_unit` the length of one step in metres (0.001 for millimetres)?"
            )
        object.__setattr__(self, "depth", depth)
        for key in ("mask", "assumed"):
            pixels = getattr(self, key)
            if pixels is not None:
                if np.shape(pixels) != depth.shape:
                    raise SceneError(
                        f"{self.name}: {key} has shape {np.shape(pixels)}; expected {depth.shape}, as depth"
                    )
                object.__setattr__(self, key, np.asarray(pixels) != 0)
        self._check_intrinsics()
        try:
            pose = rigid_transform(self.T_world_camera, "T_world_camera", unscaled=UNSCALED)
        except SceneError as error:
            raise SceneError(f"{self.name}: {error}") from error
        object.__setattr__(self, "T_world_camera", pose)

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.depth.shape[0])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.depth.shape[1])

    @property
    def measured(self) -> Bool[np.ndarray, "height width"]:
        """Pixels with depth, also completed ones."""
        return self.depth > 0

    def points(self, pixels: Bool[np.ndarray, "height width"] | None = None) -> Float[np.ndarray, "n 3"]:
        """World points [m] of the pixels with depth, in row-major order; `pixels` chooses among them."""
        rows, columns = np.nonzero(self.measured if pixels is None else self.measured & pixels)
        z = self.depth[rows, columns].astype(np.float64)
        in_camera = np.stack([(columns - self.cx) / self.fx * z, (rows - self.cy) / self.fy * z, z], axis=1)
        return in_camera @ self.T_world_camera[:3, :3].T + self.T_world_camera[:3, 3]

    def project(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return image coordinates u, v [px] and depth [m] of world points; u and v are infinite or mirrored behind."""
        rotation, position = self.T_world_camera[:3, :3], self.T_world_camera[:3, 3]
        x, y, z = ((points - position) @ rotation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([self.fx * x / z + self.cx, self.fy * y / z + self.cy, z], axis=1)

    def sees(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether world points lie in the field of view, hidden or not."""
        u, v, z = self.project(points).T
        inside = (np.abs(u - (self.width - 1) / 2) <= self.width / 2) & (
            np.abs(v - (self.height - 1) / 2) <= self.height / 2
        )
        return np.asarray(inside & (z > 0))

    def _check_intrinsics(self) -> None:
        for key, size in (("fx", self.width), ("fy", self.height), ("cx", self.width), ("cy", self.height)):
            value = finite_number(getattr(self, key), f"{self.name}: {key}")
            if key[0] == "c" and not -size <= value <= 2 * size:
                raise SceneError(
                    f"{self.name}: the principal point {key} is {value:g} px; expected it near the image of {size} px"
                )
            if key[0] == "f" and not size / WIDEST_IMAGE <= value <= size / NARROWEST_IMAGE:
                raise SceneError(
                    f"{self.name}: the focal length {key} is {value:g} px; expected a positive one, "
                    f"{size / WIDEST_IMAGE:g} to {size / NARROWEST_IMAGE:g} px for an image of {size} px; in pixels, not in "
                    "millimetres or parts of the image"
                )
            object.__setattr__(self, key, value)


def finite_number(value: Any, name: str) -> float:
    """Return a finite real number as float; True, texts and integers of hundreds of digits are none."""
    number = np.nan
    if not isinstance(value, bool | np.bool_) and isinstance(value, Real):
        with suppress(OverflowError):
            number = float(value)
    if not np.isfinite(number):
        raise SceneError(f"{name} is {quote(value)}; expected a finite number")
    return number


def depth_noise(z: float) -> float:
    """Return the axial noise [m] of a structured-light camera at depth z [m], standard deviation; `AXIAL_NOISE`."""
    least, growth, nearest = AXIAL_NOISE
    return least + growth * (z - nearest) ** 2


AGREES = 0.02  # [m] between what two views measured of one place: noise, and the error of their poses
SEEN_THROUGH = 0.03  # [m] beyond a place, where another view saw something through it


def consistent(views: Sequence[DepthView]) -> list[DepthView]:
    """Return the views without the pixels whose place more views saw through than measured something at.

    So a pixel is dropped that no other view confirms and two contradict; two views alone drop nothing.
    """
    kept = []
    for view in views:
        confirmed, contradicted = votes(view.points(), [other for other in views if other is not view])
        depth = view.depth.copy()
        depth[view.measured] = np.where(contradicted > confirmed + 1, 0.0, depth[view.measured])
        kept.append(replace(view, depth=depth) if (depth > 0).any() else view)
    return kept


def votes(
    points: Float[np.ndarray, "n 3"], views: Sequence[DepthView], *, beyond: float = SEEN_THROUGH
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return how many views confirm each point, and how many contradict it: they saw more than `beyond` [m] behind it."""
    confirmed, contradicted = np.zeros(len(points), dtype=int), np.zeros(len(points), dtype=int)
    for view in views:
        inside = np.flatnonzero(view.sees(points))
        u, v, z = view.project(points[inside]).T
        column, row = np.rint(u).astype(int), np.rint(v).astype(int)
        depth = view.depth[row.clip(0, view.height - 1), column.clip(0, view.width - 1)]
        confirmed[inside] += (depth > 0) & (np.abs(depth - z) < AGREES)
        contradicted[inside] += depth > z + beyond
    return confirmed, contradicted
