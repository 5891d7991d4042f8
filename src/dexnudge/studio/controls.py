"""How controls of the page and the session hear of each other, and texts for the page, in which nothing is markup."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from html import escape
from typing import Any

from dexnudge.studio.session import Session
from dexnudge.viewer.visual_scene import Colour

FOLDERS = re.compile(r"(?<![\w.~])(?:[A-Za-z]:)?[\\/](?:[^\s\\/'\"]+[\\/])+")  # of an absolute path
ROW = '<tr><td style="padding-right:1em;opacity:0.7;vertical-align:top">{}</td><td>{}</td></tr>'


def without_folders(text: str) -> str:
    """Return a message with the names of files, without the folders of this machine that lead to them."""
    return FOLDERS.sub("", text)


def table(rows: Mapping[str, str]) -> str:
    """Return two columns as HTML; whatever stands in them is shown, never interpreted."""
    lines = "".join(ROW.format(escape(name), escape(without_folders(value))) for name, value in rows.items())
    return f'<table style="font-size:0.85em;margin:0.4em 1em">{lines}</table>'


def legend(colours: Mapping[str, Colour]) -> str:
    """Return squares of colours (sRGB, 0..1) with their names, as HTML."""
    entries = "".join(
        f'<span style="white-space:nowrap"><span style="color:rgb({",".join(str(round(255 * each)) for each in colour)})">'
        f"&#9632;</span> {escape(name)}</span>"
        for name, colour in colours.items()
    )
    return f'<div style="display:flex;flex-wrap:wrap;gap:0 0.9em;font-size:0.75em;margin:0 1.2em">{entries}</div>'


class Reactions:
    """Hands what somebody clicked to the session; what it refuses is shown, never raised.

    after: called after each reaction.
    """

    def __init__(self, session: Session, after: Callable[[], None]) -> None:
        self.session, self.after = session, after

    def on(self, handle: Any, act: Callable[[Any], None], *, locked: bool = True) -> None:
        """Call `act` with the event when somebody changes or clicks `handle`; unless `locked`, beside what else goes on."""

        def react(event: Any) -> None:
            if event.client is None:  # the page itself set it
                return
            try:
                with self.session.telling(), self.session.lock if locked else nullcontext():
                    act(event)
            finally:
                self.after()

        (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(react)


def set_values(handle: Any, **values: Any) -> None:
    """Set what differs: each change is a message to every browser."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


def set_options(handle: Any, options: list[str], value: str) -> None:
    """Set what a dropdown offers, and what is chosen; the first where it does not offer that."""
    if list(handle.options) != options:
        handle.options = options
    handle.value = value if value in options else options[0]


def set_range(handle: Any, least: Any, most: Any, value: Any) -> None:
    """Set a slider's ends and its value, as integers where they are."""
    kind = type(handle.min)
    set_values(handle, min=kind(least), max=kind(most))
    handle.value = kind(value)
