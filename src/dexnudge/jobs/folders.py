"""An output folder that appears complete or not at all."""

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dexnudge.errors import DexnudgeError, InputError, OutputError
from dexnudge.jobs.provenance import machine, versions

TEMPORARY_PREFIX = ".writing-"


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
    """Delete the temporary files that killed writers left in `folder`; call it only while no writer is running."""
    leftovers = sorted(Path(folder).glob(f"{TEMPORARY_PREFIX}*"))
    for leftover in leftovers:
        leftover.unlink(missing_ok=True)
    return leftovers


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
                "expected equal options to go on with it; choose another --out"
            )
        return
    unfinished = path.with_suffix(".partial")  # a killed run may have left it
    if out.exists() and (not out.is_dir() or any(entry != unfinished for entry in out.iterdir())):
        raise OutputError(f"{out} exists and holds no experiment; expected a new folder; choose another --out")
    content = {"format_version": format_version, "config": ours, "versions": versions(), "machine": machine(device)}
    try:
        out.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error.strerror or error}; choose another --out") from error


def read_claim(folder: Path, file: str, *, format_version: int) -> dict[str, Any]:
    """What `claim_folder` wrote: format_version, config, versions, machine.

    Raises:
        InputError: the file is missing, damaged or of another format.
    """
    path = folder / file
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} cannot be read ({error}); expected the file that `dexnudge evaluate` or `dexnudge reproduce` wrote"
        ) from error
    if not isinstance(content, dict) or content.get("format_version") != format_version:
        raise InputError(f"{path} is of another format; expected format_version {format_version}; choose another --out")
    return content


# What a full, read-only or failing disk raises, with or without the name of a file.
DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO})


@contextmanager
def new_folder(out: Path | str, *, overwrite: bool = False, marker: str) -> Iterator[Path]:
    """Yield an empty folder beside `out`; when the block ends well it becomes `out` in one step.

    However else the block ends (an error, Ctrl-C, a full disk), the folder and the parents made for it are removed and
    `out` is as it was.

    Args:
        out: the folder to make. It must not exist, unless `overwrite`.
        overwrite: replace an existing `out`, provided that it is empty or holds the file `marker`.
        marker: name of a file that only such an output folder has; it keeps `overwrite` from deleting anything else.

    Raises:
        OutputError: `out` exists, is no folder of ours, or cannot be written.
    """
    target = Path(out).absolute()
    _refuse_existing(target, overwrite=overwrite, marker=marker)
    made_parents = [parent for parent in [target.parent, *target.parents[1:]] if not parent.exists()]
    partial = target.with_name(f".{target.name}.partial-{os.getpid()}")
    finished = False
    try:
        partial.mkdir(parents=True)
        yield partial
        _put_in_place(partial, target)
        finished = True
    except OSError as error:
        if isinstance(error, DexnudgeError) or not _concerns(error, partial, target):
            raise
        raise OutputError(
            f"cannot write the output folder {target}: {error.strerror or error}; expected a writable place with free "
            "space; nothing was left behind; choose another --out"
        ) from error
    finally:
        if not finished:
            shutil.rmtree(partial, ignore_errors=True)
            _remove_empty(made_parents)


def check_writable_place(out: Path | str) -> None:
    """Refuse a folder that cannot be made or written, without making anything.

    Raises:
        OutputError: `out` or what it would lie in is a file, or may not be written.
    """
    target = Path(out).absolute()
    existing = next(path for path in (target, *target.parents) if path.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        what = "may not be written" if existing.is_dir() else "is not a folder"
        raise OutputError(
            f"cannot write the output folder {target}: {existing} {what}; expected a writable place; choose another --out"
        )


def _refuse_existing(target: Path, *, overwrite: bool, marker: str) -> None:
    if not target.exists() and not target.is_symlink():
        return
    if not target.is_dir() or target.is_symlink():
        raise OutputError(
            f"the output {target} exists and is not a folder; expected a new folder; choose another --out"
        )
    if not overwrite:
        raise OutputError(
            f"the output folder {target} exists; expected a new one; choose another --out, or replace it with --overwrite"
        )
    if any(target.iterdir()) and not (target / marker).is_file():
        raise OutputError(
            f"the output folder {target} exists and has no {marker}, so it was not written by this command; "
            "--overwrite replaces only such folders; choose another --out"
        )


def _put_in_place(partial: Path, target: Path) -> None:
    if not target.exists():
        partial.rename(target)
        return
    old = target.with_name(f".{target.name}.replaced-{os.getpid()}")
    target.rename(old)
    try:
        partial.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old)


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
