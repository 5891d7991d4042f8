"""A document as one HTML file with pictures and charts inside: no server, no internet, no script."""

import base64
import io
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dexnudge.dataset.document import Document

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def document_page(document: Document, pictures: str) -> str:
    """Return the page: title and summary, then `pictures`, which are HTML, then the sections; text is escaped."""
    return Template((files("dexnudge.dataset") / "page.html").read_text(encoding="utf-8")).substitute(
        title=escape(document.title), summary=escape(document.summary), pictures=pictures, sections=document.html()
    )


def picture_html(
    picture: UInt8[np.ndarray, "height width 3"] | None, caption: Sequence[str], *, about: str = ""
) -> str:
    """Return a picture, or the room of one, over the lines of its caption; a reader hears what it is `about`, too."""
    lines, image = "<br>".join(map(escape, caption)), '<div class="none"></div>'
    if picture is not None:
        file = io.BytesIO()
        Image.fromarray(picture).save(file, format="PNG", optimize=False)
        text = escape(": ".join(filter(None, [about, ", ".join(caption)])))
        image = f'<img alt="{text}" src="{_url("png", file.getvalue())}">'
    return f"<figure>{image}<figcaption>{lines}</figcaption></figure>"


def pictures_html(title: str, pictures: Sequence[str]) -> str:
    """Return a row of pictures, as `picture_html` returns them, under a title."""
    shown = "\n".join(pictures)
    return f'<h2>{escape(title)}</h2>\n<div class="samples">\n{shown}\n</div>'


def chart_html(figure: "Figure", title: str) -> str:
    """Return a chart as an image: the same bytes from the same figures."""
    import matplotlib as mpl

    file = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "dexnudge"}):
        figure.savefig(file, format="svg", metadata={"Date": None}, bbox_inches="tight")
    return f'<img alt="{escape(title)}" src="{_url("svg+xml", file.getvalue())}">'


def _url(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"
