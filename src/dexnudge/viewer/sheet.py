"""Several pictures in one, with their titles."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from dexnudge.errors import InputError
from dexnudge.viewer.drawing import Drawing
from dexnudge.viewer.picture import render_array, write_png

TILE = (640, 480)  # pixels of one picture
GAP = 6  # pixels of white between pictures
TITLE_HEIGHT = 0.055  # of a tile's height
TITLE_COLOUR = (45, 52, 62)  # sRGB


def render_sheet(
    drawings: Sequence[Drawing], path: Path | str, *, columns: int = 3, tile: tuple[int, int] = TILE
) -> Path:
    """Writes the pictures of several drawings side by side, row by row, each with its title in the corner.

    Args:
        drawings: what to show; their titles are drawn too.
        path: of the PNG file.
        columns: pictures in a row.
        tile: width and height of each picture in pixels.

    Raises:
        InputError: no drawing, or fewer than one column.
        OutputError: the file cannot be written.
    """
    if not drawings or columns < 1:
        raise InputError(
            f"a sheet of {len(drawings)} pictures in {columns} columns was asked for; expected at least one of both"
        )
    pictures = [render_array(drawing, size=tile) for drawing in drawings]
    return write_png(arrange(pictures, [drawing.title for drawing in drawings], columns=columns), path)


def arrange(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]], titles: Sequence[str], *, columns: int
) -> UInt8[np.ndarray, "sheet_height sheet_width 3"]:
    """One or more pictures of one size side by side, row by row, each with its title in the corner; sRGB bytes."""
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
