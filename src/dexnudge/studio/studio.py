"""The studio: a server, a page and what it is at, opened and closed together."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from dexnudge.studio.content import read_content
from dexnudge.studio.controls import without_folders
from dexnudge.studio.panels import Panels
from dexnudge.studio.sample_panel import in_fields
from dexnudge.studio.server import HOST, PORT, open_server
from dexnudge.studio.session import Session
from dexnudge.studio.stage import Stage

FRAME_TIME = 1 / 30  # [s] between two moments that are sent while something is played
PATIENCE = 1.0  # [s] that closing waits for draws that are under way; a command has 2.5 after Ctrl-C


class Studio:
    """A page for a folder, see `read_content`, that is served from when this is made until it is closed.

    Args:
        folder: what is shown at the beginning.
        execution: a folder of executions beside that of the result.
        hand: what is sampled where the folder brings no hand.
        weights: folder of the model; the shipped one unless given.
        device: see `Sampler`.
        out: folder below which the page saves.
        host: address to listen at.
        port: to listen at, or the next free one; 0 for any.

    Raises:
        InputError: what `read_content`, `open_server` and `Sampler` refuse.
    """

    def __init__(
        self,
        folder: Path | str | None = None,
        *,
        execution: Path | str | None = None,
        hand: str = "shadow_lite",
        weights: Path | str | None = None,
        device: str = "cpu",
        out: Path | str = "runs",
        host: str = HOST,
        port: int = PORT,
    ) -> None:
        content = read_content(folder, execution=execution, hand=hand)
        self._server = open_server(host, port)
        try:
            self.session = Session(content, Stage(self._server), out=Path(out), weights=weights, device=device)
        except BaseException:
            self._server.stop()
            raise
        self._closing = threading.Event()
        self._clock = threading.Thread(target=self._tick, name="dexnudge-studio-clock", daemon=True)
        self.session.tell = self.tell
        self.panels = Panels(self._server, self.session)
        self._clock.start()

    @property
    def url(self) -> str:
        """Where the page is."""
        return self._server.url

    @property
    def port(self) -> int:
        """The port that is listened at."""
        return self._server.get_port()

    def tell(self, title: str, message: str, failed: bool) -> None:  # noqa: FBT001 - the session's callback
        """Show a message to whoever has the page open, without folders of this machine."""
        for client in self._server.get_clients().values():
            client.add_notification(
                title,
                in_fields(without_folders(message)),
                color="red" if failed else "teal",
                auto_close_seconds=None if failed else 10.0,
            )

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        try:
            while not self._closing.wait(timeout=1.0):
                pass
        except KeyboardInterrupt:
            return

    def close(self) -> None:
        """Stop serving; draws that are under way are given a second."""
        self._closing.set()
        with self.session.lock:
            self.session.changed, self.session.tell = lambda: None, lambda *_: None  # nobody looks any more
        self.session.stop()
        self.session.wait(PATIENCE)
        self._clock.join(PATIENCE)
        self._server.stop()

    def _tick(self) -> None:
        before = time.perf_counter()
        while not self._closing.wait(FRAME_TIME):
            now = time.perf_counter()
            with self.session.lock:
                self.session.tick(now - before)
            before = now
