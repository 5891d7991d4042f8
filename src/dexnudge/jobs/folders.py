"""Output folders: one owner at a time, complete or not at all, and nothing replaced that came in between."""

import ctypes
import errno
import itertools
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from dexnudge.errors import LONGEST_PART, DexnudgeError, OutputError, check_path
from dexnudge.jobs.locks import (
    LOCK_NAME,
    LOCK_SUFFIX,
    cannot_write,
    is_held,
    lock_beside,
    locked,
    refuse_held,
)

LONGEST_NAME = LONGEST_PART - len(f".{LOCK_SUFFIX}")  # bytes of a new folder's
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux
# What a full, read-only or failing disk raises, with or without the name of a file.
DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO})


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
        refuse_held(lock_beside(folder), folder, "out")
        with locked(folder / LOCK_NAME, folder, "out"):
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
    partial, lock = target.with_name(f".{target.name}.partial"), lock_beside(target)
    killed = os.path.lexists(lock)  # a run that was killed left its lock beside what it had begun
    try:
        with locked(lock, target, argument):
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
                raise cannot_write(target, error, argument) from error
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
    return next(path for path in _numbered(out) if not os.path.lexists(path) and not is_held(lock_beside(path)))


def _refuse_others(target: Path, partial: Path, argument: str) -> None:
    """Refuse to make `target` where that would delete what no run of ours has left."""
    for path in (partial, *([_old_beside(target)] if os.path.lexists(target) else [])):
        if os.path.lexists(path):
            raise OutputError(
                f"{path} stands where the output folder {target} is made, and no run of dexnudge left it; expected nothing "
                f"there; move it away, or choose another `{argument}`"
            )


def _check_replaceable(target: Path, *, overwrite: bool | None, marker: str, argument: str) -> set[str] | None:
    """What stands in the folder that is to be replaced; None where there is none."""
    if not os.path.lexists(target):
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
        refuse_held(lock, target, argument)
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
            if os.path.lexists(kept) or name.endswith(LOCK_SUFFIX) or _matches(path.relative_to(old), ours):
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
            if not os.path.lexists(path):
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
    if old.is_dir() and not os.path.lexists(target):
        old.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def _old_beside(target: Path) -> Path:
    return target.with_name(f".{target.name}.replaced")


def _numbered(path: Path) -> Iterator[Path]:
    return itertools.chain([path], (path.with_name(f"{path.name}-{number}") for number in itertools.count(2)))


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
