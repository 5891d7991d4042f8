"""Locks of output folders: the owner holds one (flock) on a small file that says who it is.

The kernel releases the lock when the process ends, however it ends, so a run that was killed owns nothing.
"""

import errno
import json
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from dexnudge.errors import OutputError, what_failed

LOCK_NAME = ".dexnudge-lock"  # in a folder that one run after another goes on with
LOCK_SUFFIX = ".dexnudge-lock"  # of `.NAME.dexnudge-lock` beside a folder that appears when it is complete
LOCK_ATTEMPTS = 1000  # each but the last lost to an owner that ended between two system calls
NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # what a link at a lock's place leads to is not ours to write
LOCKED_BYTE = 1 << 30  # beyond the text: Windows lets nobody read a locked byte


@contextmanager
def locked(lock: Path, folder: Path, argument: str) -> Iterator[None]:
    """Hold the lock on the file `lock`, which says who owns `folder`, while the block runs."""
    try:
        descriptor = _acquire(lock)
    except BlockingIOError as error:
        raise _is_owned(folder, lock, argument) from error
    except OSError as error:
        if os.path.lexists(lock) and (lock.is_symlink() or not lock.is_file()):
            kind = "a link" if lock.is_symlink() else "a folder" if lock.is_dir() else "no file"
            raise OutputError(
                f"{kind} stands at {lock}, where the lock of {folder} belongs; expected a file, or nothing; remove it, or "
                f"choose another `{argument}`"
            ) from error
        raise cannot_write(folder, error, argument) from error
    try:
        yield
    finally:
        with suppress(OSError):  # Windows keeps a file that is open
            lock.unlink()
        os.close(descriptor)


def _acquire(lock: Path) -> int:
    """Descriptor of the lock file, which stands for the lock; BlockingIOError when another process holds it."""
    missing = FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(lock))
    for _ in range(LOCK_ATTEMPTS):
        lock.parent.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | NO_LINK, 0o666)
        except FileNotFoundError as error:  # the owner before has just removed a folder that it left empty
            missing = error
            continue
        try:
            _lock(descriptor)
            with suppress(FileNotFoundError):
                if os.path.samestat(lock.stat(), os.fstat(descriptor)):
                    os.truncate(descriptor, 0)
                    os.write(descriptor, _owner().encode())
                    return descriptor
        except OSError:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the owner before removed the file after we had opened it
    raise missing  # a place where no file can be made, such as /proc


if sys.platform == "win32":

    def _lock(descriptor: int) -> None:
        import msvcrt

        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError from error
        os.lseek(descriptor, 0, os.SEEK_SET)

else:

    def _lock(descriptor: int) -> None:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_held(lock: Path) -> bool:
    """Whether a living process holds this lock."""
    try:
        descriptor = os.open(lock, os.O_RDWR | NO_LINK)
    except OSError:
        return False
    try:
        _lock(descriptor)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def refuse_held(lock: Path, folder: Path, argument: str) -> None:
    """Raise OutputError where a living process holds this lock of a folder."""
    if is_held(lock):
        raise _is_owned(folder, lock, argument)


def _is_owned(folder: Path, lock: Path, argument: str) -> OutputError:
    try:
        owner = json.loads(lock.read_text(encoding="utf-8"))
        who = f"process {owner['pid']} on {owner['host']} since {owner['since']} ({owner['command']})"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # it has only just begun, or is just ending
        who = "another process"
    return OutputError(
        f"the output folder {folder} is being written by {who}; expected one run at a time; wait for it to end, or "
        f"choose another `{argument}`"
    )


def _owner() -> str:
    """Who this process is, for whoever finds the lock held."""
    name = Path(sys.argv[0]).name
    command = " ".join(["dexnudge" if name == "__main__.py" else name, *sys.argv[1:]])
    since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    return json.dumps({"host": socket.gethostname(), "pid": os.getpid(), "command": command, "since": since})


def lock_beside(target: Path) -> Path:
    """Return where the lock of a folder lies that appears when it is complete."""
    return target.with_name(f".{target.name}{LOCK_SUFFIX}")


def cannot_write(folder: Path, error: OSError, argument: str) -> OutputError:
    """Return what is said of a folder that the system refuses to write."""
    return OutputError(
        f"cannot write the output folder {folder}: {what_failed(error)}; expected a writable place with free "
        f"space; nothing was left behind; choose another `{argument}`"
    )
