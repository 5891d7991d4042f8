"""A suite: the tasks of a benchmark as a short YAML file, fixed by names, seeds and hashes of meshes."""

import os
import re
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from dexnudge.errors import InputError, UnknownNameError, did_you_mean, quote
from dexnudge.hands.config import read_yaml
from dexnudge.jobs.json_files import Must, Name, from_fields
from dexnudge.scenes.families import SCENE_FAMILIES

BUILTIN = Path(str(files("dexnudge.benchmark"))) / "suites"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}")
MOST_DRAWS, MOST_TASKS = 128, 10_000
WORDS_OF_NAME = "letters, digits, _, - and ."
HASH = Must("the SHA-256 of a mesh, 64 hexadecimal digits", re.compile(r"([0-9a-f]{64})?").fullmatch)
OBJECTS = Must(
    f"names of {WORDS_OF_NAME}, or such names and hashes",
    lambda objects: bool(objects) and all(isinstance(name, str) and NAME.fullmatch(name) for name in objects),
)
ONCE = Must("a list without doubles", lambda values: 0 < len(values) == len({*map(str, values)}))
SEED = Must(f"0 to {2**31}", range(2**31 + 1).__contains__)


class TaskKey(NamedTuple):
    """What identifies a task within a suite: an object in a scene of a family, drawn with a seed."""

    object: str
    family: str
    seed: int

    @property
    def name(self) -> str:
        """Name of its folder and of its answer."""
        return f"{self.object}_{self.family}_{self.seed}"


@dataclass(frozen=True, kw_only=True)
class Suite:
    """The tasks: every object in every family with every seed.

    Attributes:
        name: of the suite.
        version: raised when any task changes.
        hand: name of the hand that all tasks are for.
        base: whether its forearm counts.
        draws: K, ranked configurations that an answer may hold.
        families: of scenes, built-in ones.
        seeds: of the scenes.
        objects: names of built-in objects, or of a set that is given when tasks are made -> SHA-256 of the mesh in metres
            (`mesh_hash`); "" for an object that is not pinned.
    """

    name: Annotated[str, Must(WORDS_OF_NAME, NAME.fullmatch)]
    version: Annotated[int, Must("at least 1", lambda version: version >= 1)]
    hand: Name
    base: bool
    draws: Annotated[int, Must(f"1 to {MOST_DRAWS}", range(1, MOST_DRAWS + 1).__contains__)]
    families: Annotated[tuple[str, ...], ONCE]
    seeds: Annotated[tuple[Annotated[int, SEED], ...], ONCE]
    objects: Annotated[dict[str, Annotated[str, HASH]], OBJECTS]

    @property
    def tasks(self) -> list[TaskKey]:
        """Every task, in order."""
        return [TaskKey(each, family, seed) for each in self.objects for family in self.families for seed in self.seeds]


def load_suite(name_or_file: str) -> Suite:
    """Return a built-in suite by its name, or that of a YAML file.

    Raises:
        UnknownNameError: neither a built-in suite nor a file.
        InputError: the file is no suite; the message names the key.
    """
    known = sorted(file.stem for file in BUILTIN.glob("*.yaml"))
    path = BUILTIN / f"{name_or_file}.yaml" if name_or_file in known else Path(name_or_file)
    if not os.path.isfile(path):  # noqa: PTH113 - a name of 300 letters is no file, which is no error
        raise UnknownNameError(
            f"unknown suite {quote(name_or_file)}{did_you_mean(name_or_file, known)}; expected one of {', '.join(known)}, "
            "or a YAML file"
        )
    names = [field.name for field in fields(Suite)]
    return suite_from(read_yaml(path, names, robot="suite", error=InputError), str(path))


def suite_from(content: Any, where: str) -> Suite:
    """Return the suite of what a YAML or JSON file holds; InputError where it is none, `where` begins the message."""
    if isinstance(content, dict) and isinstance(content.get("objects"), list):
        content = content | {"objects": dict.fromkeys(map(str, content["objects"]), "")}
    suite = from_fields(content, Suite, where, error=InputError, again="see docs/benchmark.md")
    for family in suite.families:
        if family not in SCENE_FAMILIES:
            raise UnknownNameError(
                f"{where}: unknown family {quote(family)}{did_you_mean(family, SCENE_FAMILIES)}; expected some of "
                f"{', '.join(SCENE_FAMILIES)}"
            )
    if len(suite.tasks) > MOST_TASKS:
        raise InputError(f"{where} has {len(suite.tasks)} tasks; expected at most {MOST_TASKS}")
    return suite
