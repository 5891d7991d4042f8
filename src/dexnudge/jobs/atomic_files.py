"""Files that are written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dexnudge.errors import OutputError

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
    """Delete the temporary files that killed writers left below `folder`; call it only while no writer is running."""
    leftovers = sorted(Path(folder).rglob(f"{TEMPORARY_PREFIX}*"))
    for leftover in leftovers:
        leftover.unlink(missing_ok=True)
    return leftovers
