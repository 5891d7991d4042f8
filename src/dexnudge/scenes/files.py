"""A scene as a folder: scene.json, object.obj and environment.obj; and poses in files of their own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import LONGEST_QUOTE, OutputError, SceneError, check_path, quote, what_failed
from dexnudge.geometry.meshes import load_environment, load_mesh
from dexnudge.geometry.rigid import real_numbers, rigid_transform
from dexnudge.jobs.json_files import path_inside, read_json, read_json_object
from dexnudge.jobs.provenance import recorded_versions
from dexnudge.scenes.motion import Turn, unit_motion
from dexnudge.scenes.uncertainty import Uncertainty

SCENE_FILE, OBJECT_FILE, ENVIRONMENT_FILE = "scene.json", "object.obj", "environment.obj"
SCENE_FILES = (SCENE_FILE, OBJECT_FILE, ENVIRONMENT_FILE)
MESH_DIGITS = 9  # decimals of a coordinate in metres: a nanometre
LINES_AT_ONCE = 100_000  # of a mesh, formatted at once
NUMBERS = ("motion_length", "mass", "friction_hand", "friction_environment", "max_normal_force")
ORIGINS = "environment_faces_seen_assumed_unseen"  # how many of each, in this order; of a scene from depth images
MARGINS = ("surface_noise", "clearance")  # [m] 0 in files of version 0.7, which lack them
LARGEST_NUMBER = 1e6  # of any physical number of a scene, in its SI unit; more overflows in products
REQUIRED = ("object_mesh", "environment_mesh", "T_world_object", "motion", *NUMBERS)


def write_scene(
    values: dict[str, Any], folder: Path, *, object_mesh: trimesh.Trimesh, environment_mesh: trimesh.Trimesh
) -> Path:
    """Write the three files into `folder`, made if need be; return the path of scene.json.

    Raises:
        OutputError: the folder cannot be written.
    """
    content = {"object_mesh": OBJECT_FILE, "environment_mesh": ENVIRONMENT_FILE, **_plain(values)}
    if (origin := environment_mesh.metadata.get("origin")) is not None:
        content[ORIGINS] = np.bincount(origin, minlength=3).tolist()
    content["versions"] = recorded_versions()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_obj(object_mesh, folder / OBJECT_FILE, "object, metres, object frame")
        _write_obj(environment_mesh, folder / ENVIRONMENT_FILE, "environment, metres, world frame, z up")
        path = folder / SCENE_FILE
        path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"{folder}: the scene cannot be written ({what_failed(error)}); expected a folder with free space that you may "
            "write to; choose another `out`"
        ) from error
    return path


def read_scene(folder: Path) -> dict[str, Any]:
    """Read the fields of `Scene` from what `write_scene` wrote, trusting nothing in it.

    Raises:
        SceneError: a file is missing, the JSON is malformed, a key is missing, a path is absolute or leaves the
            folder, or a value is of another kind.
        MeshError: a mesh cannot be used.
    """
    path = folder / SCENE_FILE
    content = read_json_object(path)
    missing = [key for key in REQUIRED if key not in content]
    if missing:
        raise SceneError(f"{path}: the key {missing[0]!r} is missing; expected {', '.join(REQUIRED)}")
    content = dict.fromkeys(MARGINS, 0.0) | content
    for key in (*NUMBERS, *MARGINS):
        if isinstance(content[key], bool) or not isinstance(content[key], int | float):
            raise SceneError(f"{path}: {key} is {content[key]!r}; expected a number")
        if abs(content[key]) > LARGEST_NUMBER:  # also an integer of hundreds of digits
            raise SceneError(f"{path}: {key} is above {LARGEST_NUMBER:g}; expected a number of an object and a scene")
    parameters, seed = content.get("parameters", {}), content.get("seed")
    if not isinstance(parameters, dict):
        raise SceneError(f"{path}: parameters is {parameters!r}; expected an object of names and values")
    for key in ("settled_mm", "settled_deg"):
        if isinstance(parameters.get(key, 0.0), bool) or not isinstance(parameters.get(key, 0.0), int | float):
            raise SceneError(f"{path}: {key} among the parameters is {parameters[key]!r}; expected a number")
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int)):
        raise SceneError(f"{path}: seed is {seed!r}; expected an integer or null")
    environment = load_environment(_mesh_file(folder, content["environment_mesh"], "environment_mesh"))
    environment.metadata.update(_origin(content.get(ORIGINS), environment, path))
    return {
        "object_mesh": load_mesh(_mesh_file(folder, content["object_mesh"], "object_mesh")),
        "environment_mesh": environment,
        "T_world_object": rigid_transform(content["T_world_object"]),
        "motion": unit_motion(content["motion"]),
        "turn": None if content.get("turn") is None else Turn.from_json(content["turn"]),
        "uncertainty": None if (unsure := content.get("uncertainty")) is None else Uncertainty.from_json(unsure),
        "name": str(content.get("scene", "user")),
        "parameters": parameters,
        "seed": seed,
        **{key: float(content[key]) for key in (*NUMBERS, *MARGINS)},
    }


def _origin(counts: Any, environment: trimesh.Trimesh, path: Path) -> dict[str, Any]:
    """Return what each face of surroundings from depth is; nothing for others. SceneError where the counts are none."""
    if counts is None:
        return {}
    faces = environment.metadata["file_faces"]
    whole = isinstance(counts, list) and len(counts) == 3 and all(type(each) is int and each >= 0 for each in counts)
    if not whole or not faces.max() < sum(counts) <= LARGEST_NUMBER * 3:
        raise SceneError(f"{path}: {ORIGINS} is {quote(counts)}; expected how many faces of the environment are which")
    return {"origin": np.repeat(np.arange(3, dtype=np.int8), counts)[faces]}


def _mesh_file(folder: Path, value: Any, key: str) -> Path:
    """Return the path of a mesh below the folder; SceneError when it points anywhere else."""
    return path_inside(folder, value, key, file=SCENE_FILE, what="mesh")


def _write_obj(mesh: trimesh.Trimesh, path: Path, title: str) -> None:
    """Vertices and faces only, in order, so that a reader gets the same triangles."""
    number = f"%.{MESH_DIGITS}f"
    with path.open("w", encoding="ascii") as file:
        file.write(f"# {title}\n")
        for line, rows in ((f"v {number} {number} {number}\n", mesh.vertices), ("f %d %d %d\n", mesh.faces + 1)):
            for part in np.array_split(np.asarray(rows), len(rows) // LINES_AT_ONCE + 1):
                file.write(line * len(part) % tuple(part.ravel().tolist()))


def _plain(value: Any) -> Any:
    """`value` with numpy numbers and arrays as plain ones, for JSON."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value


POSE_KEY, POSITION_KEY, QUATERNION_KEY = "T_world_object", "position", "quaternion_wxyz"
QUATERNION_TOLERANCE = 1e-3  # on the norm; three decimals are what people type


def load_pose(path: str | Path, key: str = POSE_KEY, argument: str = "object_pose") -> Float[np.ndarray, "4 4"]:
    """Read a pose from a JSON file: the 4 x 4 list, alone or named `key`, or "position" [m] and "quaternion_wxyz".

    Raises:
        SceneError: missing, malformed, or not a rigid pose.
    """
    check_path(argument, path, SceneError)
    path = Path(path)
    content = read_json(path)
    if (
        isinstance(content, list) and all(isinstance(row, list) for row in content) and len(content) > 1
    ):  # the bare matrix
        content = {key: content}
    if not isinstance(content, dict):
        raise SceneError(f"{path}: holds a JSON {type(content).__name__}; expected an object with named values")
    if key in content and (POSITION_KEY in content or QUATERNION_KEY in content):
        raise SceneError(
            f"{path}: holds the pose twice, as {key!r} and as {POSITION_KEY!r} or {QUATERNION_KEY!r}; expected one "
            "of them; remove the other"
        )
    if key in content:
        return rigid_transform(content[key], f"{path}: {key}")
    if POSITION_KEY not in content or QUATERNION_KEY not in content:
        raise SceneError(
            f"{path}: holds {quote(list(content))[1:-1] or 'nothing'}; expected {key!r} (4 x 4), or "
            f"{POSITION_KEY!r} (x, y, z in metres) and {QUATERNION_KEY!r}"
        )
    position = _vector(content[POSITION_KEY], 3, POSITION_KEY, path)
    quaternion = _vector(content[QUATERNION_KEY], 4, QUATERNION_KEY, path)
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1) <= QUATERNION_TOLERANCE:
        raise SceneError(f"{path}: {QUATERNION_KEY} has norm {norm:.4g}; expected 1, in the order w, x, y, z")
    pose = np.eye(4)
    pose[:3, :3] = trimesh.transformations.quaternion_matrix(quaternion / norm)[:3, :3]
    pose[:3, 3] = position
    return rigid_transform(pose, key)


def _vector(value: Any, size: int, key: str, path: Path) -> np.ndarray:
    try:
        vector = real_numbers(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f"{path}: {key} is {repr(value)[:LONGEST_QUOTE]}; expected {size} numbers") from error
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise SceneError(f"{path}: {key} is {repr(value)[:LONGEST_QUOTE]}; expected {size} finite numbers")
    return vector
