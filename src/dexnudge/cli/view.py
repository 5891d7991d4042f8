"""`dexnudge view`: the studio."""

from __future__ import annotations

import os
import sys
from contextlib import closing
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro

from dexnudge.cli.arguments import Count, DeviceOptions, Folder, OptionalFolder, Text, metavar, say
from dexnudge.cli.scene_options import RUNS
from dexnudge.errors import InputError

HOST, PORT = "127.0.0.1", 8080


@dataclass(frozen=True, kw_only=True)
class View(DeviceOptions):
    """Open the studio: a page in the browser that shows draws, plays executions and plans, and samples changed scenes.

    It is served to this machine alone until Ctrl-C ends it; port 0 takes any free one.
    """

    folder: tyro.conf.Positional[Annotated[str | None, metavar("DIR|PLAN")]] = None
    """Folder that `sample`, `plan`, `execute` or `scene` wrote; a phone on a table unless given."""
    execution: OptionalFolder = None
    """Folder of executions that is not inside that of the result."""
    hand: Text = "shadow_lite"
    """Built-in hand, or a URDF or MJCF file, where DIR brings none; an unknown name lists them."""
    weights: OptionalFolder = None
    """Folder of the model that samples; the shipped one unless given."""
    out: Folder = str(RUNS)
    """Folder below which the page's "Save" writes."""
    host: Text = HOST
    """Address to listen at; whoever reaches it can sample and save: 0.0.0.0 is everybody on the network."""
    port: Count = PORT
    """Port to listen at; the next free one where it is taken."""

    def run(self) -> int:
        """Serve until interrupted; draws that are under way then are given up."""
        if find_spec("viser") is None:
            raise InputError(
                "the studio needs the package viser, which is not installed; expected it; mend it with: "
                "pip install 'dexnudge[studio]'"
            )
        from dexnudge.studio.studio import Studio

        opened = Studio(
            self.folder,
            execution=self.execution,
            hand=self.hand,
            weights=self.weights,
            device=self.device,
            out=Path(self.out),
            host=self.host,
            port=self.port,
        )
        code = 0
        try:
            with closing(opened) as studio:
                if self.port not in (0, studio.port):
                    say(f"port {self.port} is taken; the next free one is {studio.port}")
                say(f"studio: {studio.url}", "Ctrl-C ends it")
                studio.wait()
        except KeyboardInterrupt:  # before it waits, or while it closes
            pass
        except SystemExit as ended:  # SIGTERM
            code = int(ended.code or 0)
        if opened.session.working:  # compiled code that nothing interrupts; Python would abort if it ended around it
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
        return code
