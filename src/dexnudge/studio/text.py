"""Texts for the page: nothing in them is markup, and none of them tells where files lie on this machine."""

import re
from collections.abc import Mapping
from html import escape

FOLDERS = re.compile(r"(?<![\w.~])(?:[A-Za-z]:)?[\\/](?:[^\s\\/'\"]+[\\/])+")  # of an absolute path
ROW = '<tr><td style="padding-right:1em;opacity:0.7;vertical-align:top">{}</td><td>{}</td></tr>'


def without_folders(text: str) -> str:
    """Return a message with the names of files, without the folders of this machine that lead to them."""
    return FOLDERS.sub("", text)


def table(rows: Mapping[str, str]) -> str:
    """Return two columns as HTML; whatever stands in them is shown, never interpreted."""
    lines = "".join(ROW.format(escape(name), escape(without_folders(value))) for name, value in rows.items())
    return f'<table style="font-size:0.85em;margin:0.4em 1em">{lines}</table>'
