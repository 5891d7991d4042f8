"""The server of the page: on this machine alone unless told otherwise, never through a tunnel, for its own page alone."""

import errno
import re
import socket
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from http import HTTPStatus
from io import StringIO
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

import viser
from websockets.asyncio import server as websockets
from websockets.http11 import Request, Response

from dexnudge.errors import InputError, check_integer

HOST, PORT = "127.0.0.1", 8080
LARGEST_PORT = 65_535
ADDRESS = re.compile(r"[0-9.]+|.*:.*")  # an address in numbers, which no foreign name server can give


class Server(viser.ViserServer):
    """viser's server, without its way to publish the page through somebody else's machine."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002, FBT001, FBT002 - viser's signature
        """Return None: whatever a browser asks for, no tunnel is opened."""
        return None

    @property
    def url(self) -> str:
        """Where the page is."""
        host = self.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self.get_port()}"


def open_server(host: str = HOST, port: int = PORT) -> Server:
    """Return a server that listens on `port`, or on the next free one; 0 lets the system choose.

    Raises:
        InputError: an address that is not of this machine, or a port that is invalid or may not be used.
    """
    check_integer("port", port, least=0, most=LARGEST_PORT)
    try:
        family = socket.getaddrinfo(host, port)[0][0]
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise InputError(
                f"the studio cannot listen at `host` {host}, `port` {port}: {error.strerror or error}; expected an address "
                f"of this machine, such as {HOST}, and a port that you may use, such as {PORT}"
            ) from error
    # viser draws a box around the address, and has no option for whom it serves.
    guard = patch.object(websockets, "serve", side_effect=partial(_serve, host, websockets.serve))
    with redirect_stdout(StringIO()), guard as guarded:
        server = Server(host=host, port=port, label="dexnudge", verbose=False)
    if not guarded.called:
        server.stop()
        raise InputError(
            f"viser {viser.__version__} serves any web page; expected one that can be told not to, such as 1.1.1"
        )
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    # An environment map takes seconds to prepare where no graphics card does it; shadows draw everything several times.
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(enabled=False, cast_shadow=False)
    server.scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(140, 140, 150), intensity=1.6)
    server.scene.add_light_directional("/sun", intensity=1.8, position=(-1.0, -0.6, 2.0), cast_shadow=False)
    return server


def _serve(
    host: str, serve: Callable[..., Any], *args: Any, process_request: Callable[..., Any], **options: Any
) -> Any:
    return serve(*args, process_request=partial(_answer, host, process_request), **options)


def _answer(
    host: str, page: Callable[..., Response | None], connection: websockets.ServerConnection, request: Request
) -> Response | None:
    """Answer as `page` does; refuse what another web page sends, or what came by a name that is not this machine's."""
    asked = request.headers.get("Host", "")
    name = urlsplit(f"//{asked}").hostname or ""
    own = name in ("localhost", host.lower(), socket.gethostname().lower()) or ADDRESS.fullmatch(name)
    if not own or request.headers.get("Origin", f"http://{asked}") not in (f"http://{asked}", f"https://{asked}"):
        return connection.respond(
            HTTPStatus.FORBIDDEN, "refused: expected the studio's own page, by an address of its machine\n"
        )
    return page(connection, request)
