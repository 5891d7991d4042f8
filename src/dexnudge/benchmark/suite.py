"""A suite: the tasks of a benchmark as a short YAML file, fixed by names, seeds and hashes of meshes."""

import os
import re
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from dexnudge.errors import InputError, UnknownNameError, check_integer, did_you_mean, quote
from dexnudge.hands.config import read_yaml
from dexnudge.scenes.families import SCENE_FAMILIES

BUILTIN = Path(str(files("dexnudge.benchmark"))) / "suites"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}")
MOST_DRAWS, MOST_TASKS = 128, 10_000
HASH = re.compile(r"[0-9a-f]{64}")


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

    name: str
    version: int
    hand: str
    base: bool
    draws: int
    families: tuple[str, ...]
    seeds: tuple[int, ...]
    objects: dict[str, str]

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
    return suite_from(read_yaml(path, names, robot="suite", needed=names, error=InputError), str(path))


def suite_from(content: Any, where: str) -> Suite:
    """Return the suite of what a YAML or JSON file holds; InputError where it is none, `where` begins the message."""
    names = [field.name for field in fields(Suite)]
    if not isinstance(content, dict) or set(content) != set(names):
        got = ", ".join(map(str, content)) if isinstance(content, dict) else type(content).__name__
        raise InputError(f"{where} is no suite: got {quote(got)}; expected the keys {', '.join(names)}")
    content = dict(content)
    if isinstance(content["objects"], list):
        content["objects"] = dict.fromkeys(map(str, content["objects"]), "")
    _check_names(content, where)
    for key in ("families", "seeds"):
        value = content[key]
        if not isinstance(value, list) or not value or len({*map(str, value)}) < len(value):
            raise InputError(f"{where}: {key} is {quote(value)}; expected a list without doubles")
        content[key] = tuple(value)
    for family in content["families"]:
        if family not in SCENE_FAMILIES:
            raise UnknownNameError(
                f"{where}: unknown family {quote(family)}{did_you_mean(family, SCENE_FAMILIES)}; expected some of "
                f"{', '.join(SCENE_FAMILIES)}"
            )
    for seed in content["seeds"]:
        check_integer("seeds", seed, least=0, most=2**31)
    check_integer("version", content["version"], least=1)
    check_integer("draws", content["draws"], least=1, most=MOST_DRAWS)
    suite = Suite(**content)
    if len(suite.tasks) > MOST_TASKS:
        raise InputError(f"{where} has {len(suite.tasks)} tasks; expected at most {MOST_TASKS}")
    return suite


def _check_names(content: dict[str, Any], where: str) -> None:
    objects, hand, base = content["objects"], content["hand"], content["base"]
    if not isinstance(objects, dict) or not objects:
        raise InputError(f"{where}: objects is {quote(objects)}; expected names, or names and hashes")
    for name in (content["name"], *objects):
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise InputError(f"{where}: {quote(name)} is no name; expected letters, digits, _, - and .")
    for name, digest in objects.items():
        if not isinstance(digest, str) or (digest and not HASH.fullmatch(digest)):
            raise InputError(f"{where}: the hash of {name} is {quote(digest)}; expected 64 hexadecimal digits")
    if not isinstance(hand, str) or not isinstance(base, bool):
        raise InputError(f"{where}: hand is {quote(hand)} and base {quote(base)}; expected a name, and true or false")
