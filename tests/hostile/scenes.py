"""Hostile scenes: the JSON of poses, and of folders that `scene` wrote."""

from __future__ import annotations

import random
from functools import cache
from typing import Any

import numpy as np

from hostile.case import CONTROL, MARKUP, MISSING_HAND, Content, Draw, Hole, Hostile, Link, Pipe, as_content
from hostile.meshes import OWN, table_top
from hostile.mutations import changed_value, damaged_bytes, damaged_json, odd_values

POSE: list[Any] = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.00395], [0.0, 0.0, 0.0, 1.0]]
POSES = (
    POSE,
    {"T_world_object": POSE},
    {"position": [0.0, 0.0, 0.00395], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]},
)
TURN = {"angle": 0.5, "axis": [0, 0, 1], "point": [0, 0, 0]}
UNSURE = {"friction": [0.5, 1.0], "friction_environment": [1.0, 1.0], "mass": [1.0, 2.0], "max_normal_force": [1.0, 1.0],
          "pose_mm": 2.0, "pose_deg": 0.0, "height_mm": 0.0, "worlds": 16, "seed": 0}  # fmt: skip


@cache
def _folder() -> dict[str, Any]:
    """Return scene.json and the meshes of a phone on a table."""
    import tempfile
    from pathlib import Path

    import dexnudge as dn
    from dexnudge.jobs.json_files import read_json_object

    with tempfile.TemporaryDirectory() as place:
        dn.build_scene("table", "phone").save(place)
        files: dict[str, Any] = {path.name: path.read_bytes() for path in Path(place).iterdir()}
        return files | {"scene.json": read_json_object(Path(place) / "scene.json")}


def scene_case(name: str, content: Any, expected: Any = "either", says: str = "", **files: Content) -> Hostile:
    """Return the case of a scene folder with this scene.json; `files` (a__b for a/b) take the place of the valid."""
    meshes = {f"scene/{key}": value for key, value in _folder().items() if key != "scene.json"}
    data = as_content(content)
    changed = {f"scene/{key}": value for key, value in files.items()}
    arguments = ("scene", "scene", "--hand", MISSING_HAND, "--out", "out")
    return Hostile("scene.json", name, meshes | {"scene/scene.json": data} | changed, arguments, expected, says)


def pose_case(name: str, content: Any, expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of surroundings of one's own with this pose."""
    data = as_content(content)
    files = {"room.ply": table_top(), "pose.json": data}
    return Hostile("pose", name, files, ("scene", "phone", "--environment", "room.ply", *OWN), expected, says)


def _pose(rng: random.Random) -> Hostile:
    return pose_case(*damaged_json(rng.choice(POSES), rng))


def _scene(rng: random.Random) -> Hostile:
    content = dict(_folder()["scene.json"])
    if rng.random() < 0.15:
        mesh = rng.choice(("object.obj", "environment.obj"))
        what, data = damaged_bytes(_folder()[mesh], rng)
        return scene_case(f"{mesh}: {what}", content, **{mesh: data})
    if rng.random() < 0.3:
        content |= {"turn": TURN, "uncertainty": UNSURE, "environment_faces_seen_assumed_unseen": [12, 0, 0]}
        key = rng.choice(("turn", "uncertainty", "environment_faces_seen_assumed_unseen", "parameters"))
        what, content[key] = changed_value(content[key], rng)
        return scene_case(f"{key}: {what}", content)
    if rng.random() < 0.5:
        key = rng.choice(list(content))
        return scene_case(f"another {key}", content | {key: odd_values(rng)})
    return scene_case(*damaged_json(content, rng))


def _numbers(key: str) -> list[Hostile]:
    values = (float("nan"), float("inf"), 1e300, -1, 10**400, True, "1", None, [1])
    return [scene_case(f"{key} {str(value)[:20]}", _folder()["scene.json"] | {key: value}, "refused")
            for value in values]  # fmt: skip


def _moved(**numbers: float) -> list[Any]:
    pose = np.array(POSE)
    for place, value in numbers.items():
        pose[int(place[1]), int(place[2])] = value
    return pose.tolist()


def handmade() -> list[Hostile]:
    """Return the cases made by hand; the folder that they change is made first."""
    valid = _folder()["scene.json"]
    poses = {
        "valid": (POSE, "accepted", ""),
        "valid, as position": (POSES[2], "accepted", ""),
        "an integer of 400 digits": ([*_moved()[:3], [0, 0, 0, 10 ** 400]], "refused", ""),
        "an integer of 5,000 digits": (b"[[" + b"9" * 5000 + b"]]", "refused", ""),
        "NaN": (_moved(p00=float("nan")), "refused", ""),
        "infinity": (_moved(p03=float("inf")), "refused", ""),
        "1e300 m away": (_moved(p03=1e300), "refused", ""),
        "1e12 m away": (_moved(p03=1e12), "refused", ""),
        "a mirror": (_moved(p00=-1.0), "refused", ""),
        "zeros": (np.zeros((4, 4)).tolist(), "refused", ""),
        "a scale of 2": ((2 * np.eye(4)).tolist(), "refused", ""),
        "3 x 4": (POSE[:3], "refused", ""),
        "true for 1": ([[True, 0, 0, 0], *POSE[1:]], "refused", ""),
        "text for numbers": ([["1", "0", "0", "0"], *POSE[1:]], "refused", ""),
        "a quaternion of zeros": ({"position": [0, 0, 0], "quaternion_wxyz": [0, 0, 0, 0]}, "refused", "norm"),
        "a quaternion of 1e200": ({"position": [0, 0, 0], "quaternion_wxyz": [1e200, 1e200, 0, 0]}, "refused", "norm"),
        "the pose twice": (POSES[1] | POSES[2], "refused", "twice"),
        "a key twice": (b'{"T_world_object": [], "T_world_object": []}', "refused", "twice"),
        "no key of ours": ({MARKUP: 1, CONTROL: 2}, "refused", ""),
        "100,000 keys": ({f"k{i}": 0 for i in range(100_000)}, "refused", ""),
        "nested 100,000 deep": (b"[" * 100_000 + b"]" * 100_000, "refused", ""),
        "nested 900 deep": (b'{"T_world_object": ' + b"[" * 900 + b"1" + b"]" * 900 + b"}", "refused", ""),
        "a list of 1e6 numbers": ([[0.0] * 1_000_000] * 4, "refused", ""),
        "rows of different lengths": ([[1], [1, 2], [], [3]], "refused", ""),
        "an object in place of a number": ([[{}, 0, 0, 0], *POSE[1:]], "refused", ""),
        "UTF-16": (str(POSE).encode("utf-16"), "refused", ""),
        "a mark before it": (b"\xef\xbb\xbf" + str(POSE).encode(), "either", ""),
        "a lone surrogate": (b'{"\\ud800": 1}', "refused", ""),
        "empty": (b"", "refused", ""),
        "null": (None, "refused", ""),
        "a pipe": (Pipe(), "refused", ""),
        "a device": (Link("/dev/zero"), "refused", ""),
        "a hole of 90 MB": (Hole(90_000_000, b"["), "refused", ""),
        "a hole of 10 GB": (Hole(10**10), "refused", ""),
        "90 MB of lists": (b"[" + b"[]," * 30_000_000 + b"[]]", "refused", ""),
        "30 MB of lists": (b"[" + b"[]," * 10_000_000 + b"[]]", "refused", ""),
        "a link to nothing": (Link("nothing"), "refused", ""),
    }  # fmt: skip
    scenes = {
        "valid": (valid, "accepted", ""),
        "no keys": ({}, "refused", "missing"),
        "a list": ([], "refused", "list"),
        "a mesh outside": (valid | {"object_mesh": "../../../../../etc/passwd"}, "refused", "outside"),
        "a mesh at an absolute path": (valid | {"environment_mesh": "/etc/passwd"}, "refused", "outside"),
        "a mesh with backslashes": (valid | {"object_mesh": "..\\..\\x.obj"}, "refused", "outside"),
        "a mesh with a NUL": (valid | {"object_mesh": "a\0.obj"}, "refused", "object_mesh"),
        "a mesh's name of 5,000 letters": (valid | {"object_mesh": "a" * 5000 + ".obj"}, "refused", ""),
        "a mesh's name of control characters": (valid | {"object_mesh": CONTROL + ".obj"}, "refused", ""),
        "a mesh's name with a lone surrogate": (valid | {"object_mesh": "\ud800.obj"}, "refused", ""),
        "the folder for a mesh": (valid | {"object_mesh": "."}, "refused", ""),
        "a name of markup": (valid | {"scene": MARKUP}, "accepted", ""),
        "a name of control characters": (valid | {"scene": CONTROL}, "either", ""),
        "a name of 10 MB": (valid | {"scene": "a" * 10_000_000}, "either", ""),
        "parameters nested 900 deep": (as_content(valid)[:-1] + b', "parameters2": ' + b"[" * 900 + b"]" * 900 + b"}", "either", ""),
        "a motion of zeros": (valid | {"motion": [0, 0, 0]}, "refused", "motion"),
        "a motion of NaN": (valid | {"motion": [float("nan"), 0, 0]}, "refused", ""),
        "a motion of 1e-320": (valid | {"motion": [1e-320, 0, 0]}, "either", ""),
        "no motion": (valid | {"motion": None}, "refused", "motion"),
        "a seed of 10^400": (valid | {"seed": 10**400}, "either", ""),
        "a turn of 1e300": (valid | {"turn": TURN | {"angle": 1e300}}, "refused", "turn"),
        "a turn about a zero axis": (valid | {"turn": TURN | {"axis": [0, 0, 0]}}, "refused", "turn"),
        "a way of 1,000 km": (valid | {"motion_length": 1e6}, "refused", ""),
        "a mass of 0": (valid | {"mass": 0}, "refused", "mass"),
        "a mass of 1e-300": (valid | {"mass": 1e-300}, "either", ""),
        "a friction of 1e6": (valid | {"friction_hand": 1e6}, "either", ""),
        "a clearance of 1 km": (valid | {"clearance": 1000}, "either", ""),
        "worlds of 1e9": (valid | {"uncertainty": UNSURE | {"worlds": 10**9}}, "refused", "worlds"),
        "origins of 1e18 faces": (valid | {"environment_faces_seen_assumed_unseen": [10**18, 0, 0]}, "refused", ""),
        "a pipe": (Pipe(), "refused", ""),
    }  # fmt: skip
    page = {key: _folder()[key] for key in ("object.obj", "environment.obj")}
    drawn = {
        f"scene/{key}": value for key, value in (page | {"scene.json": as_content(valid | {"scene": MARKUP})}).items()
    }
    return [
        *(pose_case(name, *values) for name, values in poses.items()),
        *(scene_case(name, *values) for name, values in scenes.items()),
        *_numbers("mass"), *_numbers("motion_length"), *_numbers("friction_hand"), *_numbers("clearance"),
        scene_case("a mesh that leads outside", valid, "refused", **{"object.obj": Link("../../../../../../etc/passwd")}),
        scene_case("a mesh that is a pipe", valid, "refused", **{"object.obj": Pipe()}),
        Hostile("scene.json", "a page of markup", drawn, ("scene", "scene", "--out", "out"), "accepted"),
    ]  # fmt: skip


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"pose": _pose, "scene.json": _scene}
