"""results.jsonl: one line for each object, scene and method of an experiment.

Each line is a JSON object with the fields of `Row`. Lines stand in the order in which they were finished; the triple
(object, scene, method) occurs once. A line is written whole; one that a killed run left unfinished is dropped.
"""

import json
import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

from dexnudge.errors import InputError, OutputError

FILE = "results.jsonl"
RowKey = tuple[str, str, str]


@dataclass(frozen=True, kw_only=True)
class Row:
    """What became of one object in one scene with one method.

    Attributes:
        status: "sampled", or "failed" when the object could not be read or does not fit the scene; a failed row counts
            as `num` draws without success.
        reason: why it failed; empty when sampled.
        num: draws attempted.
        seed: of the scene and of the draws.
        success: of each draw, in ranked order: verified ones first, best first.
        force_margin: of each draw, same order.
        penetration_mm: the deepest of the three penetrations of each draw, same order; null where the draw is no pose.
        own_rank: place of each draw in the sampler's own order, before verification; same order.
        joint_diversity [rad], contact_diversity [half lengths of the object]: of the verified draws; null where
            fewer than two are.
        swept: success of each draw, same order, at other frictions and masses, by `sweeps.setting_name`; empty where the
            experiment does not ask for it.
        rejected: draws that did not succeed, by reason.
        seconds: by stage.
    """

    object: str
    scene: str
    method: str
    status: Literal["sampled", "failed"]
    reason: str = ""
    num: int
    seed: int
    success: list[bool] = field(default_factory=list)
    force_margin: list[float] = field(default_factory=list)
    penetration_mm: list[float | None] = field(default_factory=list)
    own_rank: list[int] = field(default_factory=list)
    joint_diversity: float | None = None
    contact_diversity: float | None = None
    swept: dict[str, list[bool]] = field(default_factory=dict)
    rejected: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> RowKey:
        """What identifies the row within an experiment."""
        return (self.object, self.scene, self.method)


Line = TypeVar("Line")


def read_rows(folder: Path) -> list[Row]:
    """All whole lines of `FILE`; none when there is no file.

    Raises:
        InputError: a line that is not a `Row`, or one that occurs twice; the message names the line.
    """
    return read_lines(folder, Row)


def read_lines(folder: Path, kind: type[Line]) -> list[Line]:
    """All whole lines of `FILE` as objects of a dataclass that has a `key`; see `read_rows`."""
    path = folder / FILE
    if not path.exists():
        return []
    rows: dict[RowKey, Line] = {}
    names = {f.name for f in fields(cast(Any, kind))}
    for number, line in enumerate(_whole_lines(path.read_bytes()), start=1):
        try:
            content = json.loads(line)
            row: Any = kind(**{name: content[name] for name in names})
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{path}, line {number}: {type(error).__name__}: {error}; expected a JSON object with the fields "
                f"{', '.join(sorted(names))}; delete the line to have it computed again"
            ) from error
        if row.key in rows:
            raise InputError(f"{path}, line {number}: {row.key} occurs twice; delete one of the lines")
        rows[row.key] = row
    return list(rows.values())


class RowWriter:
    """Appends rows so that a killed process leaves only whole lines, and at most one unfinished one at the end.

    Raises:
        OutputError: the file cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        try:
            if self._path.exists():
                content = self._path.read_bytes()
                os.truncate(self._path, len(content) - len(content.rpartition(b"\n")[2]))
            self._file = self._path.open("ab")
        except OSError as error:
            raise self._cannot_write(error) from error

    def append(self, row: Any) -> None:
        """Write one row, an object of a dataclass, and have it reach the disk."""
        try:
            self._file.write((json.dumps(asdict(row), allow_nan=False) + "\n").encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._cannot_write(error) from error

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def _cannot_write(self, error: OSError) -> OutputError:
        return OutputError(
            f"cannot write {self._path}: {error.strerror or error}; expected a writable file with free space; "
            "finished rows are kept, and the same command goes on from there"
        )


def _whole_lines(content: bytes) -> list[bytes]:
    return content.split(b"\n")[:-1]
