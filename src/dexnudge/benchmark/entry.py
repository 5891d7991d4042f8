"""An entry: the folder that a method fills, read without trust.

    ENTRY/entry.json            who and what: see `Entry`
    ENTRY/answers/TASK.json     or TASK.npz: ranked draws for the task, the best first

An answer holds joint_names (d,), T_world_palm (n, 4, 4) [m] and joint_angles (n, d) [rad], [m] of joints that slide.
"""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dexnudge.benchmark.suite import NAME
from dexnudge.benchmark.tasks import TaskSet
from dexnudge.errors import LONGEST_NAME, InputError, did_you_mean, is_name, quote
from dexnudge.formats.hand_poses import configurations
from dexnudge.hands.hand import Hand
from dexnudge.jobs.archives import read_arrays
from dexnudge.jobs.json_files import MAX_TABLE_BYTES, path_inside, read_json_object

ENTRY, ANSWERS = "entry.json", "answers"
KEYS = ("T_world_palm", "joint_angles", "joint_names")
SUFFIXES = (".json", ".npz")
ARCHIVE = "an npz archive without pickles"
MOST_SECONDS = 10**9  # of a task: 30 years
LARGEST_ANSWER = 2**24  # [bytes] a hundred draws are some 100 kB


@dataclass(frozen=True)
class Answer:
    """The draws for a task. q: (n, 9 + d), world; NaN where `wrong` says what is wrong with a draw."""

    q: Float[np.ndarray, "n coordinates"]
    wrong: dict[int, str]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What entry.json says.

    Attributes:
        folder: of the entry.
        name: of the method, in tables.
        authors: who made the entry.
        used: data, weights and knowledge of the scene that the method used.
        machine: on which the answers were made.
        seconds: that each task took, by its name; may be left out.
    """

    folder: Path
    name: str
    authors: str
    used: str
    machine: str
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def hash(self) -> str:
        """SHA-256 of entry.json and of all answers; of a file that is too large to be an answer, of its size."""
        digest = hashlib.sha256((self.folder / ENTRY).read_bytes())
        for path in sorted(filter(Path.is_file, (self.folder / ANSWERS).glob("*"))):
            size = path.stat().st_size
            digest.update(os.fsencode(path.name) + str(size).encode())
            if size <= LARGEST_ANSWER and os.access(path, os.R_OK):
                digest.update(path.read_bytes())
        return digest.hexdigest()


def load_entry(folder: Path | str, tasks: TaskSet) -> Entry:
    """Return an entry for these tasks; its answers are read one by one, see `read_answer`.

    Raises:
        InputError: entry.json is missing or malformed, answers of tasks that there are not, or no answers at all.
    """
    folder = Path(folder)
    path, again = folder / ENTRY, "see docs/benchmark.md"
    content = read_json_object(path, error=InputError, expected="an entry of a benchmark", again=again)
    texts = ("name", "authors", "used", "machine")
    for key in texts:
        text = content.get(key)
        if not is_name(text) or not str(text).strip():
            raise InputError(
                f"{path}: {key} is {quote(text)}; expected one line of printable text, at most {LONGEST_NAME} characters; "
                f"{again}"
            )
    if not NAME.fullmatch(content["name"]):
        raise InputError(f"{path}: name is {quote(content['name'])}; expected letters, digits, _, - and .")
    names = [task.name for task in tasks.tasks]
    seconds = content.get("seconds", {})
    if not isinstance(seconds, dict):
        raise InputError(f"{path}: seconds is {quote(seconds)}; expected an object: a number for the name of each task")
    for name, value in seconds.items():
        if name not in names:
            raise InputError(
                f"{path}: seconds names {quote(name)}, which is no task{did_you_mean(name, names)}; expected names of the "
                f"folders in {tasks.folder / 'tasks'}"
            )
        if type(value) not in (int, float) or not 0 <= value < MOST_SECONDS:
            raise InputError(
                f"{path}: seconds of {name} is {quote(value)}; expected a number from 0 to {MOST_SECONDS:,}"
            )
    answers = sorted(file for file in (folder / ANSWERS).glob("*") if _may_answer(file, names))
    for file in answers:
        if file.suffix not in SUFFIXES:
            raise InputError(f"{file} ends in {quote(file.suffix)}; expected {' or '.join(SUFFIXES)}; rename it")
        if file.stem not in names:
            raise InputError(
                f"{file} is an answer to no task{did_you_mean(file.stem, names)}; expected TASK.json or TASK.npz with the "
                f"names of the folders in {tasks.folder / 'tasks'}"
            )
    if not answers:
        raise InputError(f"{folder / ANSWERS} holds no answers; expected {names[0]}.json and the others; {again}")
    return Entry(folder=folder, seconds=seconds, **{key: content[key] for key in texts})


def _may_answer(file: Path, names: Sequence[str]) -> bool:
    """Whether a file is meant as an answer, by its name; notes may lie beside answers."""
    return not file.name.startswith(".") and (file.suffix in SUFFIXES or file.stem in names)


def read_answer(entry: Entry, name: str, hand: Hand, *, most: int) -> Answer:
    """Return the entry's draws for a task.

    Raises:
        InputError: it is missing, no file, there twice, a link out of the folder, damaged, of other joints, or holds more
            draws than `most`.
    """
    folder = entry.folder / ANSWERS
    there = [file for file in (f"{name}{suffix}" for suffix in SUFFIXES) if os.path.lexists(folder / file)]
    for file in there:
        if not (folder / file).is_file():
            path, kind = folder / file, "a pipe or a device"
            kind = "a folder" if path.is_dir() else "a link to nothing" if not path.exists() else kind
            raise InputError(f"{file} is {kind}; expected a file")
    if len(there) != 1:
        raise InputError("there is no answer" if not there else "there are two answers; expected one")
    path = path_inside(entry.folder, f"{ANSWERS}/{there[0]}", "an answer", file=ENTRY, what="answer")
    if path.stat().st_size > LARGEST_ANSWER:
        raise InputError(f"the answer has {path.stat().st_size >> 20} MiB; expected at most {LARGEST_ANSWER >> 20} MiB")
    try:
        if path.suffix == ".json":
            content = read_json_object(path, error=InputError, constant=float, largest=MAX_TABLE_BYTES)
        else:
            content = read_arrays(path, folder="an answer", content=ARCHIVE, largest=LARGEST_ANSWER, only=KEYS)
    except InputError as error:  # goes into a report, which is handed on
        raise InputError(str(error).replace(str(path), path.name)) from error
    missing = [key for key in KEYS if key not in content]
    if missing:
        raise InputError(f"{there[0]} lacks {', '.join(missing)}; expected {', '.join(KEYS)}")
    poses = content["T_world_palm"]
    if isinstance(poses, list) or np.ndim(poses):
        _check_draws(len(poses), most, there[0])  # before work is done on each
    q, wrong = configurations(hand, *(content[key] for key in KEYS), where=there[0])
    _check_draws(len(q), most, there[0])
    return Answer(q, wrong)


def _check_draws(number: int, most: int, where: str) -> None:
    if not 0 < number <= most:
        raise InputError(f"{where} holds {number} draws; expected 1 to {most}")
