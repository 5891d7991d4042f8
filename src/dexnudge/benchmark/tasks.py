"""The tasks of a suite as folders that need nothing else, and a manifest by which anyone sees that they are the same.

    DIR/manifest.json       suite, fingerprint, SHA-256 of every file, tasks that could not be made and why
    DIR/hand/hand.urdf      the hand of all tasks, with meshes, YAML and MJCF
    DIR/tasks/TASK/         scene.json, object.obj, environment.obj, as `Scene.save` writes them

The fingerprint is that of the hand, scenes and meshes, and of what is to be done, whatever versions they were made with.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from dexnudge.benchmark.suite import Suite, TaskKey, suite_from
from dexnudge.errors import InputError, MeshError, SceneError
from dexnudge.experiments.config import TrialKey, trial_seed
from dexnudge.hands.export import HAND_FILES, export_hand
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.json_files import MAX_TABLE_BYTES, read_json_object
from dexnudge.jobs.provenance import versions
from dexnudge.objects.builtin import builtin_object, is_builtin
from dexnudge.objects.sets import ObjectEntry, resolve_object_set
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.files import SCENE_FILE, SCENE_FILES
from dexnudge.scenes.scene import Scene
from dexnudge.synthesis.object_data import mesh_hash

MANIFEST, HAND, TASKS = "manifest.json", "hand", "tasks"
FORMAT_VERSION = 1
OURS = (*(f"{HAND}/{file}" for file in HAND_FILES), *(f"{TASKS}/*/{file}" for file in SCENE_FILES))


@dataclass(frozen=True)
class TaskSet:
    """The tasks of a suite in a folder, all of their files as they were made.

    tasks: those that could be made. not_made: name of each other one, and why. fingerprint: see `_fingerprint`.
    """

    folder: Path
    suite: Suite
    tasks: tuple[TaskKey, ...]
    not_made: dict[str, str]
    fingerprint: str

    @cached_property
    def hand(self) -> Hand:
        """The hand of all tasks."""
        return load_hand(str(self.folder / HAND / "hand.urdf"))

    def scene(self, task: TaskKey) -> Scene:
        """Return the scene of a task."""
        return Scene.load(self.folder / TASKS / task.name)


def make_tasks(
    suite: Suite,
    out: Path | str,
    *,
    objects: str | None = None,
    units: str = "m",
    length: float | None = None,
    overwrite: bool = False,
    on_done: Callable[[int, int], None] | None = None,
) -> TaskSet:
    """Write the tasks of a suite into a new folder; the same suite and objects give the same fingerprint.

    objects, units, length: the set in which objects that are not built in are found by name, as `resolve_object_set`.

    Raises:
        InputError: an object is missing, or its mesh is not the one that the suite names by its hash.
        OutputError: `out` exists, or cannot be written.
    """
    meshes = _meshes(suite, objects, units, length)
    not_made: dict[str, str] = {}
    with new_folder(out, overwrite=overwrite, marker=MANIFEST, ours=OURS) as folder:
        export_hand(load_hand(suite.hand, base=suite.base), folder / HAND)
        for done, task in enumerate(suite.tasks, start=1):
            try:
                seed = trial_seed(task.seed, TrialKey(task.object, task.family, ""))
                scene = build_scene(task.family, meshes[task.object].copy(), seed=seed)
                scene.validate()
                scene.save(folder / TASKS / task.name)
            except (SceneError, MeshError) as error:
                not_made[task.name] = str(error)
            if on_done:
                on_done(done, len(suite.tasks))
        made = [task for task in suite.tasks if task.name not in not_made]
        if not made:
            raise InputError(f"no task of suite '{suite.name}' can be made: {next(iter(not_made.values()))}")
        content = {"format_version": FORMAT_VERSION, "suite": asdict(suite), "not_made": not_made}
        content |= {"fingerprint": _fingerprint(folder, suite, made, not_made), "files": _hashes(folder, made)}
        content["versions"] = versions()
        (folder / MANIFEST).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return load_tasks(out)


def load_tasks(folder: Path | str) -> TaskSet:
    """Return the tasks that `make_tasks` wrote.

    Raises:
        InputError: no such folder, a manifest of another format, or a file that is missing or was changed.
    """
    folder, again = Path(folder), "make the tasks again with `dexnudge benchmark make`"
    expected = "the folder that `dexnudge benchmark make` wrote"
    content = read_json_object(
        folder / MANIFEST, error=InputError, expected=expected, again=again, largest=MAX_TABLE_BYTES
    )
    if content.get("format_version") != FORMAT_VERSION or not isinstance(content.get("not_made"), dict):
        raise InputError(f"{folder / MANIFEST} is of another format; expected format_version {FORMAT_VERSION}; {again}")
    suite = suite_from(content.get("suite"), f"{folder / MANIFEST}: suite")
    tasks = [task for task in suite.tasks if task.name not in content["not_made"]]
    written, found = content.get("files"), _hashes(folder, tasks)
    for name in found:
        if not isinstance(written, dict) or written.get(name) != found[name]:
            raise InputError(f"{folder / name} is not the file that the manifest was made with; {again}")
    not_made = content["not_made"]
    return TaskSet(folder, suite, tuple(tasks), not_made, _fingerprint(folder, suite, tasks, not_made))


def _meshes(suite: Suite, objects: str | None, units: str, length: float | None) -> dict[str, Any]:
    """Return the mesh of each object [m]."""
    given: dict[str, ObjectEntry] = {}
    if objects is not None:
        given = {entry.name: entry for entry in resolve_object_set(objects, units=units, length=length)}
    missing = [name for name in suite.objects if name not in given and not is_builtin(name)]
    if missing:
        raise InputError(
            f"suite '{suite.name}' needs {len(missing)} objects that are not built in, such as {missing[0]}; expected them "
            f"in `objects`, a folder or list of meshes{'' if objects is None else f', not in {objects}'}"
        )
    meshes = {name: given[name].load() if name in given else builtin_object(name) for name in suite.objects}
    for name, digest in suite.objects.items():
        if digest and mesh_hash(meshes[name]) != digest:
            raise InputError(
                f"the mesh of {name} is not the one that suite '{suite.name}' names: expected SHA-256 {digest[:12]}…, got "
                f"{mesh_hash(meshes[name])[:12]}…; give the original mesh, at its scale"
            )
    return meshes


def _hashes(folder: Path, tasks: list[TaskKey]) -> dict[str, str]:
    """Return the SHA-256 of every file, by its path in the folder; "" of one that is missing."""
    names = [f"{TASKS}/{task.name}/{file}" for task in tasks for file in SCENE_FILES]
    names += sorted(str(path.relative_to(folder)) for pattern in HAND_FILES for path in (folder / HAND).glob(pattern))
    return {name: _sha256(folder / name) for name in names}


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _fingerprint(folder: Path, suite: Suite, tasks: list[TaskKey], not_made: dict[str, str]) -> str:
    """Return the SHA-256 of draws, names of tasks, the hand's files, scenes and meshes, without the scenes' versions."""
    asked = [suite.hand, suite.base, suite.draws, [task.name for task in tasks], sorted(not_made), _hashes(folder, [])]
    digest = hashlib.sha256(json.dumps(asked, sort_keys=True).encode())
    for task in tasks:
        place = folder / TASKS / task.name
        content = read_json_object(place / SCENE_FILE)
        content.pop("versions", None)
        digest.update(f"{task.name} {json.dumps(content, sort_keys=True)}".encode())
        digest.update("".join(_sha256(place / file) for file in SCENE_FILES if file != SCENE_FILE).encode())
    return digest.hexdigest()
