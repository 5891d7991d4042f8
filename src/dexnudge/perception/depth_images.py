"""Depth images and masks as PNG files: their header is read before anything is decoded."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt16
from PIL import Image

from dexnudge.errors import SceneError, what_failed

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
