"""results.jsonl: one line for each trial, in the order in which they finished.

Each line is a JSON object: the kind of trial and the fields of its record. The key (object, scene, method) occurs once.
A line is written whole; one that a killed run left unfinished is dropped.
"""

import json
import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

from dexnudge.errors import InputError, writing
from dexnudge.experiments.config import TrialKey
from dexnudge.jobs.json_files import from_fields, refuse_constant, unique_keys

FILE = "results.jsonl"
ADDED = ("repairs",)  # fields that lines of 0.7 lack


@dataclass(frozen=True, kw_only=True)
class TrialRecord:
    """What a trial found: an object in a scene with a method. A kind of trial derives its own record from this one.

    Attributes:
        status: "done"; "unverified", where a trial needs a verified draw and there is none; "failed", where the object
            cannot be read, does not fit its scene, cannot be simulated, or the worker process died.
        reason: why it failed; "" where it did not.
        seed: seed of the scene and of the draws.
        num: draws attempted. verified: those that are verified.
        seconds: by stage.
    """

    kind: ClassVar[str]

    object: str
    scene: str
    method: str
    status: Literal["done", "unverified", "failed"] = "done"
    reason: str = ""
    seed: int
    num: int
    verified: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> TrialKey:
        """What identifies the record within an experiment."""
        return TrialKey(self.object, self.scene, self.method)

    @property
    def succeeded(self) -> bool:
        """Whether the trial reached its goal with the configuration that a robot would use: a verified one."""
        return self.verified > 0


Record = TypeVar("Record", bound=TrialRecord)


def read_records(folder: Path, kind: type[Record]) -> list[Record]:
    """Return the records on all whole lines of the folder's `FILE`; none when there is no file.

    kind: `TrialRecord` itself reads the common fields of records of any kind.

    Raises:
        InputError: a line that is no such record, or that occurs twice; the message names the line.
    """
    path = folder / FILE
    if not path.exists():
        return []
    records: dict[TrialKey, Record] = {}
    for number, line in enumerate(path.read_bytes().split(b"\n")[:-1], start=1):
        try:
            record = _decoded(json.loads(line, parse_constant=refuse_constant, object_pairs_hook=unique_keys), kind)
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            names = ", ".join(sorted(each.name for each in fields(kind)))
            raise InputError(
                f"{path}, line {number}: {type(error).__name__}: {error}; expected a JSON object with the fields kind, "
                f"{names}; delete the line to have it computed again"
            ) from error
        if record.key in records:
            raise InputError(f"{path}, line {number}: {tuple(record.key)} occurs twice; delete one of the lines")
        records[record.key] = record
    return list(records.values())


def _decoded(content: Any, kind: type[Record]) -> Record:
    if kind is not TrialRecord and content["kind"] != kind.kind:
        raise ValueError(f"a record of kind {content['kind']!r} among those of kind {kind.kind!r}")
    if missing := [each.name for each in fields(kind) if each.name not in (*ADDED, *content)]:
        raise KeyError(*missing)
    return from_fields(content, kind, "the record", error=InputError, again="as dexnudge writes it", others=True)


TO_GO_ON = (
    "expected a writable file with free space; finished records are kept, and the same command goes on from there"
)


class RecordWriter:
    """Appends records so that a killed process leaves only whole lines, and at most one unfinished one at the end.

    Raises:
        OutputError: the file cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        with writing(self._path, TO_GO_ON):
            if self._path.exists():
                content = self._path.read_bytes()
                os.truncate(self._path, len(content) - len(content.rpartition(b"\n")[2]))
            self._file = self._path.open("ab")

    def append(self, record: TrialRecord) -> None:
        """Write a record and have it reach the disk."""
        with writing(self._path, TO_GO_ON):
            self._file.write((json.dumps({"kind": record.kind, **asdict(record)}, allow_nan=False) + "\n").encode())
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()
