"""A hostile input: files, the command that reads them, and what must come of it."""

from __future__ import annotations

import json
import os
import random
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

MARKUP = "<script>alert(1)</script>"  # in names; no page may hold it as it stands
CONTROL = "\x1b[31mred\x07\u202etxt"  # in names; no message may hold it as it stands
MISSING_HAND = "ends_here.urdf"  # commands that build a scene before they load the hand end at it, and draw nothing


@dataclass(frozen=True)
class Link:
    """A symbolic link to be made in the place of a file."""

    target: str


class Pipe:
    """A FIFO to be made in the place of a file: who opens it waits for ever."""


@dataclass(frozen=True)
class Hole:
    """A file of so many zeros behind a beginning, which takes no room on the disk."""

    size: int
    begins: bytes = b""


Content = bytes | Link | Pipe | Hole


@dataclass(frozen=True)
class Hostile:
    """An input that may be anything, and the command that reads it.

    Attributes:
        reader: what reads it, such as "obj" or "urdf"; campaigns count by it.
        name: what was done to it.
        files: content by relative path; the command runs in their folder, and may write below its `out` only.
        arguments: of `dexnudge`.
        expected: whether it must be refused (exit 2, one message), must be accepted, or either.
        says: text that the message holds.
    """

    reader: str
    name: str
    files: Mapping[str, Content]
    arguments: tuple[str, ...]
    expected: Literal["refused", "accepted", "either"] = "either"
    says: str = ""

    def write(self, folder: Path) -> None:
        """Write the files into `folder`."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Link):
                path.symlink_to(content.target)
            elif isinstance(content, Hole):
                path.write_bytes(content.begins)
                os.truncate(path, content.size)
            elif isinstance(content, Pipe):
                os.mkfifo(path)
            else:
                path.write_bytes(content)


Draw = Callable[[random.Random], Hostile]


def written(files: Mapping[str, Content]) -> Path:
    """Return a new folder with these files."""
    folder = Path(tempfile.mkdtemp())
    Hostile("", "", files, ()).write(folder)
    return folder


def copied(folder: Path) -> dict[str, bytes]:
    """Return the files of a valid folder, to be changed; the folder is removed."""
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    shutil.rmtree(folder)
    return files


def as_content(value: Any) -> Content:
    """Return a file's content as it is, and any other value as JSON, also NaN and infinity."""
    return value if isinstance(value, Content) else json.dumps(value).encode()
