"""The end of a command that was told to end while a library was busy and answered nothing."""

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

GRACE = 2.5  # [s] from the signal on; longer than any of a job's own steps that save something


@contextmanager
def ended_after_signal(message: str, *, seconds: float = GRACE) -> Iterator[None]:
    """End this process `seconds` after SIGINT or SIGTERM, wherever it is then, unless the block ends before.

    Python answers a signal between two of its own steps, and one call of a library may take minutes. Such an end costs no
    more than a kill, which every job survives: the item that it was at. Exit code 128 + signal, with `message` on stderr.
    Only the main thread may call it.
    """
    told, tell = socket.socketpair()
    tell.setblocking(False)
    over = threading.Event()
    before = signal.set_wakeup_fd(tell.fileno(), warn_on_full_buffer=False)

    def watch() -> None:
        while number := told.recv(1):
            if number[0] in (signal.SIGINT, signal.SIGTERM) and not over.wait(seconds):
                print(message, file=sys.stderr, flush=True)
                os._exit(128 + number[0])

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        tell.shutdown(socket.SHUT_RDWR)  # a forked process may have it open, too
        watching.join()
        tell.close()
        told.close()
