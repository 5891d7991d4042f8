"""The text of a page that loads nothing: templates, data and scripts that stand inside it."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from dexnudge.errors import OutputError
from dexnudge.viewer.palette import PALETTE, Role


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
