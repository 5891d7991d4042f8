"""Output folders and files: one owner at a time, complete or not at all, and nothing replaced that came in between.

The owner of a folder holds the lock (flock) on a small file that says who it is. The kernel releases the lock when the
process ends, however it ends, so a run that was killed owns nothing.
"""

import ctypes
import errno
import itertools
import json
import os
import shutil
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from dexnudge.errors import (
    LONGEST_PART,
    DexnudgeError,
    InputError,
    OutputError,
    check_path,
    quote,
    what_failed,
    writing,
)
from dexnudge.jobs.json_files import MAX_TABLE_BYTES, read_json_object
from dexnudge.jobs.provenance import machine, versions

TEMPORARY_PREFIX = ".writing-"
LOCK_NAME = ".dexnudge-lock"  # in a folder that one run after another goes on with
LOCK_SUFFIX = ".dexnudge-lock"  # of `.NAME.dexnudge-lock` beside a folder that appears when it is complete
LONGEST_NAME = LONGEST_PART - len(f".{LOCK_SUFFIX}")  # bytes of such a folder's
LOCK_ATTEMPTS = 1000  # each but the last lost to an owner that ended between two system calls
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux
NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # what a link at a lock's place leads to is not ours to write
LOCKED_BYTE = 1 << 30  # beyond the text: Windows lets nobody read a locked byte
# What a full, read-only or failing disk raises, with or without the name of a file.
DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO})


@contextmanager
def replace_atomically(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on a clean exit its file takes the place of `path` in one step.

    The temporary file is removed when the block raises. A writer that is killed leaves it behind, under a name that no
    reader looks at; `remove_leftovers` clears it. Raises OutputError when the folder cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            with temporary.open("rb") as written:
                os.fsync(written.fileno())  # without it a power cut could leave the final name on an empty file
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot write {path}: {error}; expected a writable folder with free space; choose another folder."
        ) from error


def remove_leftovers(folder: Path | str) -> list[Path]:
    """Delete the temporary files that killed writers left below `folder`; call it only while no writer is running."""
    leftovers = sorted(Path(folder).rglob(f"{TEMPORARY_PREFIX}*"))
    for leftover in leftovers:
        leftover.unlink(missing_ok=True)
    return leftovers


@contextmanager
def owned_folder(out: Path | str) -> Iterator[Path]:
    """Own the folder `out` while the block runs; for runs that a later one goes on with.

    It is made where it is missing, and removed again if the block leaves it empty.

    Raises:
        OutputError: another process owns it, or it cannot be written.
    """
    folder = _named(out, "out")
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        _refuse_held(_lock_beside(folder), folder, "out")
        with _locked(folder / LOCK_NAME, folder, "out"):
            yield folder
    finally:
        _remove_empty(made)


@contextmanager
def new_folder(
    out: Path | str, *, overwrite: bool | None = False, marker: str, ours: Sequence[str] = (), argument: str = "out"
) -> Iterator[Path]:
    """Own `out` and yield an empty folder beside it; when the block ends well it becomes `out` in one step.

    However else the block ends (an error, Ctrl-C, a full disk), the folder and the parents made for it are removed and
    `out` is as it was. What appears at `out` in the meantime stays: the new folder is then kept as `out-2`, or with the
    next free number, and OutputError says so.

    Args:
        out: the folder to make. It must not exist, unless `overwrite`.
        overwrite: replace an existing `out`, provided that it is empty or holds the file `marker`. Only the files that
            such an output consists of are replaced; everything else in `out` stays. None: no, and the caller has no such
            option.
        marker: name of a file that only such an output folder has.
        ours: what else such an output consists of, as patterns of paths in it, such as "hand/meshes/*.obj".
        argument: what the caller's user calls `out`, for messages.

    Raises:
        OutputError: another process owns `out`; it exists, is no folder of ours, or cannot be written.
    """
    check_path(argument, out, OutputError)
    target = _named(out, argument)
    if len(os.fsencode(target.name)) > LONGEST_NAME:
        raise OutputError(
            f"the name of the output folder {target} is too long; expected at most {LONGEST_NAME} bytes; choose another "
            f"`{argument}`"
        )
    made = [path for path in target.parents if not path.exists()]
    partial, lock = target.with_name(f".{target.name}.partial"), _lock_beside(target)
    killed = _exists(lock)  # a run that was killed left its lock beside what it had begun
    try:
        with _locked(lock, target, argument):
            if not killed:
                _refuse_others(target, partial, argument)
            shutil.rmtree(partial, ignore_errors=True)
            _restore(target)
            replaced = _check_replaceable(target, overwrite=overwrite, marker=marker, argument=argument)
            try:
                partial.mkdir()
                yield partial
                if replaced is not None:
                    _keep_others(target, partial, (marker, *ours))
                _put_in_place(partial, target, replaced)
            except OutputError as error:
                if str(partial) not in str(error):
                    raise
                raise OutputError(str(error).replace(str(partial), str(target))) from error
            except OSError as error:
                if isinstance(error, DexnudgeError) or not _concerns(error, partial, target):
                    raise
                raise _cannot_write(target, error, argument) from error
            finally:
                shutil.rmtree(partial, ignore_errors=True)
    finally:
        _remove_empty(made)


def _named(out: Path | str, argument: str) -> Path:
    """Return the absolute path of an output folder; OutputError for one without a name, such as /."""
    path = Path(out).absolute()
    if not str(out) or not path.name:
        raise OutputError(f"`{argument}` is {str(out)!r}; expected the path of a folder to make; name one")
    return path


def free_folder(out: Path) -> Path:
    """The first of `out`, `out-2`, `out-3`, ... that neither exists nor is being written."""
    return next(path for path in _numbered(out) if not _exists(path) and not _is_held(_lock_beside(path)))


def claim_folder(out: Path, file: str, config: dict[str, Any], *, format_version: int, device: str) -> None:
    """Make `out` the folder of a run with these options, or see that it already is.

    Raises:
        InputError: it holds a run with other options; the message names the first that differs.
        OutputError: it holds something else, or cannot be written.
    """
    path = out / file
    ours = json.loads(json.dumps(config))
    if path.is_file():
        theirs = read_claim(out, file, format_version=format_version)["config"]
        differing = [key for key in ours if theirs.get(key) != ours[key]]
        if differing:
            key = differing[0]
            raise InputError(
                f"{out} holds another experiment: {key} is {theirs.get(key)!r} there and {ours[key]!r} here; "
                "expected equal options to go on with it; choose another `out`"
            )
        return
    unfinished = path.with_suffix(".partial")  # a killed run may have left it
    ignored = (unfinished.name, LOCK_NAME)
    if out.exists() and (not out.is_dir() or any(entry.name not in ignored for entry in out.iterdir())):
        raise OutputError(f"{out} exists and holds no experiment; expected a new folder; choose another `out`")
    content = {"format_version": format_version, "config": ours, "versions": versions(), "machine": machine(device)}
    with writing(out, "choose another `out`"):
        out.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(path)


def read_claim(folder: Path, file: str, *, format_version: int) -> dict[str, Any]:
    """What `claim_folder` wrote: format_version, config, versions, machine.

    Raises:
        InputError: the file is missing, damaged or of another format.
    """
    path = folder / file
    expected = "the file that `dexnudge evaluate` or `dexnudge reproduce` wrote"
    again = (
        f"the records beside it are not lost: the same command with another `out` writes an equal {file} at once; stop it, "
        "and copy that file here"
    )
    content = read_json_object(path, error=InputError, expected=expected, again=again, largest=MAX_TABLE_BYTES)
    if content.get("format_version") != format_version:
        raise InputError(f"{path} is of another format; expected format_version {format_version}; choose another `out`")
    if not isinstance(content.get("config"), dict):
        raise InputError(f"{path}: config is {quote(content.get('config'))}; expected the run's options; {again}")
    return content


@contextmanager
def _locked(lock: Path, folder: Path, argument: str) -> Iterator[None]:
    """Hold the lock on the file `lock`, which says who owns `folder`, while the block runs."""
    try:
        descriptor = _acquire(lock)
    except BlockingIOError as error:
        raise _is_owned(folder, lock, argument) from error
    except OSError as error:
        if _exists(lock) and (lock.is_symlink() or not lock.is_file()):
            kind = "a link" if lock.is_symlink() else "a folder" if lock.is_dir() else "no file"
            raise OutputError(
                f"{kind} stands at {lock}, where the lock of {folder} belongs; expected a file, or nothing; remove it, or "
                f"choose another `{argument}`"
            ) from error
        raise _cannot_write(folder, error, argument) from error
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


def _is_held(lock: Path) -> bool:
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


def _refuse_held(lock: Path, folder: Path, argument: str) -> None:
    if _is_held(lock):
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


def _lock_beside(target: Path) -> Path:
    return target.with_name(f".{target.name}{LOCK_SUFFIX}")


def _refuse_others(target: Path, partial: Path, argument: str) -> None:
    """Refuse to make `target` where that would delete what no run of ours has left."""
    for path in (partial, *([_old_beside(target)] if _exists(target) else [])):
        if _exists(path):
            raise OutputError(
                f"{path} stands where the output folder {target} is made, and no run of dexnudge left it; expected nothing "
                f"there; move it away, or choose another `{argument}`"
            )


def _check_replaceable(target: Path, *, overwrite: bool | None, marker: str, argument: str) -> set[str] | None:
    """What stands in the folder that is to be replaced; None where there is none."""
    if not _exists(target):
        return None
    if not target.is_dir() or target.is_symlink():
        raise OutputError(
            f"the output {target} exists and is not a folder; expected a new folder; choose another `{argument}`"
        )
    if not overwrite:
        how = "" if overwrite is None else ", or replace it with `overwrite`"
        raise OutputError(f"the output folder {target} exists; expected a new one; choose another `{argument}`{how}")
    names = {entry.name for entry in target.iterdir()}
    if names and marker not in names:
        raise OutputError(
            f"the output folder {target} exists and has no {marker}, so it was not written by this command; "
            f"`overwrite` replaces only such folders; choose another `{argument}`"
        )
    for lock in target.glob(f"*{LOCK_SUFFIX}"):
        _refuse_held(lock, target, argument)
    return names


def _keep_others(old: Path, new: Path, ours: Sequence[str]) -> None:
    """Give `new` everything of `old` that is not an output's own file; links to the same files where the disk has them."""

    def refuse(error: OSError) -> None:
        raise error  # a folder that cannot be looked into would be lost

    for folder, subfolders, files in os.walk(old, onerror=refuse):
        for name in (*files, *subfolders):
            path = Path(folder, name)
            kept = new / path.relative_to(old)
            if path.is_dir() and not path.is_symlink():
                if not any(path.iterdir()):
                    kept.mkdir(parents=True, exist_ok=True)
                continue
            if _exists(kept) or name.endswith(LOCK_SUFFIX) or _matches(path.relative_to(old), ours):
                continue
            kept.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(path, kept, follow_symlinks=False)
            except (OSError, NotImplementedError):  # a disk or a system without such links
                shutil.copy2(path, kept, follow_symlinks=False)


def _matches(path: Path, patterns: Sequence[str]) -> bool:
    return any(len(path.parts) == pattern.count("/") + 1 and path.match(pattern) for pattern in patterns)


def _put_in_place(partial: Path, target: Path, replaced: set[str] | None) -> None:
    """Rename `partial` to `target`, whose old content `replaced` goes; keep it beside what has appeared there since."""
    if replaced is not None and target.is_dir() and {entry.name for entry in target.iterdir()} <= replaced:
        if _exchange(partial, target):
            return  # what was there is `partial` now, which goes
        old = _old_beside(target)
        target.rename(old)
        try:
            partial.rename(target)
        except OSError:
            old.rename(target)
            raise
        shutil.rmtree(old)
        return
    for path in _numbered(target):
        try:
            partial.rename(path)  # fails on a file or a folder that holds something
        except OSError:
            if not _exists(path):
                raise
            continue
        if path != target:
            raise OutputError(
                f"something else appeared at the output folder {target} while this ran; expected nothing there; it is as "
                f"it was, and the result is complete in {path}"
            )
        return


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders take each other's place in one step; False where the system or the disk cannot."""
    try:
        renameat2 = ctypes.CDLL(None).renameat2
    except (AttributeError, OSError, TypeError):  # not Linux
        return False
    return renameat2(AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), RENAME_EXCHANGE) == 0


def _restore(target: Path) -> None:
    """Put back what a run that was killed while it replaced it had set aside."""
    old = _old_beside(target)
    if old.is_dir() and not _exists(target):
        old.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def _old_beside(target: Path) -> Path:
    return target.with_name(f".{target.name}.replaced")


def _numbered(path: Path) -> Iterator[Path]:
    return itertools.chain([path], (path.with_name(f"{path.name}-{number}") for number in itertools.count(2)))


def _exists(path: Path) -> bool:
    return path.exists() or path.is_symlink()


def _cannot_write(folder: Path, error: OSError, argument: str) -> OutputError:
    return OutputError(
        f"cannot write the output folder {folder}: {what_failed(error)}; expected a writable place with free "
        f"space; nothing was left behind; choose another `{argument}`"
    )


def _concerns(error: OSError, partial: Path, target: Path) -> bool:
    """Whether an error is about writing the folder, and not, say, about reading an input file."""
    if error.errno in DISK_ERRORS:
        return True
    if not isinstance(error.filename, str | os.PathLike):
        return False
    path = Path(error.filename).absolute()
    return path in (target, partial) or partial in path.parents or path in partial.parents


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:  # not made, or in use by somebody else by now
            return
