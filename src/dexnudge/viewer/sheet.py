"""Several pictures in one, with their titles."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
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
    width, height = tile
    columns = min(columns, len(drawings))
    rows = -(-len(drawings) // columns)
    sheet = Image.new("RGB", (columns * (width + GAP) - GAP, rows * (height + GAP) - GAP), "white")
    font = ImageFont.load_default(TITLE_HEIGHT * height)
    for index, drawing in enumerate(drawings):
        corner = (index % columns * (width + GAP), index // columns * (height + GAP))
        sheet.paste(Image.fromarray(render_array(drawing, size=tile)), corner)
        margin = round(TITLE_HEIGHT * height / 2)
        ImageDraw.Draw(sheet).text(
            (corner[0] + margin, corner[1] + margin), drawing.title, fill=TITLE_COLOUR, font=font
        )
    return write_png(np.asarray(sheet), path)
