"""The server of the page: on this machine alone unless told otherwise, never through a tunnel, for its own page alone.

What browsers send is checked before viser acts on it: what is malformed is dropped, and numbers stay within their control.
"""

import asyncio
import errno
import math
import re
import socket
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from http import HTTPStatus
from io import StringIO
from ipaddress import ip_address
from typing import Any
from unittest.mock import patch

import msgspec
import viser
from viser.infra import Message
from websockets.asyncio import server as websockets
from websockets.http11 import Request, Response

from dexnudge.errors import LONGEST_NAME, InputError, check_integer, quote

HOST, PORT = "127.0.0.1", 8080
LARGEST_PORT = 65_535
AUTHORITY = re.compile(r"([\w.-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?", re.ASCII)  # a whole Host header


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
        InputError: an address that is not of this machine, or a port that is invalid, may not be used, or is taken as are
            all that follow.
    """
    check_integer("port", port, least=0, most=LARGEST_PORT)
    port = _free_port(host, port)
    # viser draws a box around the address, and has no option for whom it serves.
    warnings.filterwarnings(
        "ignore", message=r"\[viser\] (?s:.*) does not match annotation"
    )  # such a message is dropped
    opened: list[Server] = []
    serve = partial(_serve, host, partial(_control, opened), websockets.serve)
    guard = patch.object(websockets, "serve", side_effect=serve)
    with redirect_stdout(StringIO()), guard as guarded:
        server = Server(host=host, port=port, label="dexnudge", verbose=False)
    opened.append(server)
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
    server.scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(170, 170, 180), intensity=2.2)
    server.scene.add_light_directional("/sun", intensity=1.5, position=(-1.0, -0.6, 2.0), cast_shadow=False)
    return server


def _free_port(host: str, port: int) -> int:
    """Return the first port from `port` on that is free: viser counts beyond the last one, and waits without end."""
    for each in range(port, LARGEST_PORT + 1):
        try:
            family = socket.getaddrinfo(host, each)[0][0]
            socket.create_server((host, each), family=family).close()
        except (OSError, UnicodeError) as error:  # the latter of a name that none can have
            if getattr(error, "errno", None) == errno.EADDRINUSE:
                continue
            why = getattr(error, "strerror", None) or error
            raise InputError(
                f"the studio cannot listen at `host` {quote(host)}, `port` {each}: {why}; expected an address "
                f"of this machine, such as {HOST}, and a port that you may use, such as {PORT}"
            ) from error
        return each
    raise InputError(
        f"the studio cannot listen at `host` {quote(host)}: no free port from {port} to {LARGEST_PORT}; expected one; give "
        f"a lower `port`, such as {PORT}, or 0 for any"
    )


def _serve(
    host: str,
    control: Callable[[str], Any],
    serve: Callable[..., Any],
    handle: Callable[..., Any],
    *args: Any,
    process_request: Callable[..., Any],
    **options: Any,
) -> Any:
    async def handle_admitted(connection: websockets.ServerConnection) -> None:
        receive = connection.recv

        async def receive_admitted() -> bytes:
            while (message := admitted(await receive(), control)) is None:
                pass
            return message

        connection.recv = receive_admitted  # type: ignore[assignment, method-assign]
        await handle(connection)

    asyncio.get_running_loop().set_exception_handler(_failed)
    return serve(handle_admitted, *args, process_request=partial(_answer, host, process_request), **options)


def _control(opened: list[Server], identifier: str) -> Any:
    """Return a control of the page; viser has no public way to find one."""
    return opened[0].gui._gui_input_handle_from_uuid.get(identifier) if opened else None  # noqa: SLF001


def _failed(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Say in a line that viser failed at a message of a browser; anything else is told as ever."""
    task = context.get("future")
    if isinstance(task, asyncio.Task) and getattr(task.get_coro(), "__name__", "") == "_handle_incoming_message":
        print(f"dexnudge: a browser's message failed: {quote(context.get('exception'))}", file=sys.stderr)
    else:
        loop.default_exception_handler(context)


def _answer(
    host: str, page: Callable[..., Response | None], connection: websockets.ServerConnection, request: Request
) -> Response | None:
    """Answer as `page` does; refuse what another web page sends, or what came by a name that is not this machine's."""
    hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
    found = AUTHORITY.fullmatch(hosts[0]) if len(hosts) == 1 else None
    name = found[1].strip("[]").lower() if found else ""
    own = name in ("localhost", host.lower(), socket.gethostname().lower()) or _is_address(name)
    if not (found and own) or (origins and origins not in ([f"http://{hosts[0]}"], [f"https://{hosts[0]}"])):
        return connection.respond(
            HTTPStatus.FORBIDDEN, "refused: expected the studio's own page, by an address of its machine\n"
        )
    try:
        return page(connection, request)
    except OSError:  # of a path that no file can have
        return connection.respond(HTTPStatus.NOT_FOUND, "not found\n")


def _is_address(name: str) -> bool:
    """Whether a name is an address in numbers, which no foreign name server can give."""
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


UPDATE = "GuiUpdateMessage"
MALFORMED = (msgspec.MsgspecError, AttributeError, KeyError, TypeError, ValueError, ArithmeticError, RecursionError)
"""What reading a message that no page of ours sent may raise."""


def admitted(raw: bytes | str, control: Callable[[str], Any]) -> bytes | None:
    """Return a browser's message as viser may read it; None for one that is malformed or sets what is no value.

    control: the control of an identifier, or None; with `value`, and `min` and `max` where it has them.
    """
    if isinstance(raw, str):
        return None
    try:
        message = Message.deserialize(raw)
        if any(isinstance(value, list) for value in vars(message).values()):  # a tuple of another length
            return None
        fields = msgspec.msgpack.decode(raw)
        if fields["type"] != UPDATE:
            return raw
        handle, updates = control(fields["uuid"]), fields["updates"]
        if handle is None or set(updates) != {"value"}:
            return None
        fields["updates"] = {"value": within(handle, updates["value"])}
        return msgspec.msgpack.encode(fields)
    except MALFORMED:
        return None


def within(handle: Any, value: Any) -> Any:
    """Return a value that a control can have, the nearest where a number is beyond its ends.

    Raises:
        ValueError: of another kind, too long, or not finite.
    """
    now = handle.value
    if isinstance(now, bool | str):
        if not isinstance(value, type(now)) or (isinstance(value, str) and len(value) > LONGEST_NAME):
            raise ValueError
        return value
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError
    least, most = getattr(handle, "min", None), getattr(handle, "max", None)
    value = value if least is None else max(value, least)
    return type(now)(value if most is None else min(value, most))
