"""Hostile grasp files of other tools: DexGraspNet, BODex and DexGraspBench."""

from __future__ import annotations

import io
import pickle
import random
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import dexnudge as dn
from dexnudge.formats.dexgraspnet import ROTATION, TRANSLATION, their_joint_names
from hostile.case import CONTROL, MARKUP, Content, Draw, Hole, Hostile, Link, Pipe, copied
from hostile.mutations import changed_value, damaged_bytes, odd_values

GRASPS = 2
COMMAND = ("convert", "grasps.npy", "--to", "dexnudge", "--scene", "scene", "--out", "out")


@cache
def scene() -> dict[str, bytes]:
    """Return the files of a phone on a table."""
    folder = Path(tempfile.mkdtemp())
    dn.build_scene("table", "phone").save(folder)
    return {f"scene/{name}": content for name, content in copied(folder).items()}


def saved(content: Any) -> bytes:
    """Return what `numpy.save` makes of a dict or a list, whatever is in it."""
    array = np.empty(() if isinstance(content, dict) else len(content), dtype=object)
    array[...] = content
    file, deepest = io.BytesIO(), sys.getrecursionlimit()
    sys.setrecursionlimit(10_000)  # for lists in lists
    np.save(file, array, allow_pickle=True)
    sys.setrecursionlimit(deepest)
    return file.getvalue()


@cache
def dexgraspnet() -> list[dict[str, Any]]:
    """Return the entries of a hand above the phone."""
    hand = dn.load_hand("shadow_lite")
    qpos = dict.fromkeys((*TRANSLATION, *ROTATION, *their_joint_names(hand)), 0.0) | {"WRJTz": 0.3}
    radius = float(np.linalg.norm(dn.build_scene("table", "phone").object_mesh.vertices, axis=1).max())
    return [{"qpos": dict(qpos), "scale": radius} for _ in range(GRASPS)]


@cache
def bodex() -> dict[str, Any]:
    """Return the record of the same, of numbers in lists."""
    names = list(dn.load_hand("shadow_lite").joint_names)
    moment = [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, *[0.0] * len(names)]
    poses = {"robot_pose": [[[moment] * 3] * GRASPS], "obj_pose": [[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]}
    return {**poses, "joint_names": names, "obj_scale": [1.0]}


@cache
def dexgraspbench() -> dict[str, Any]:
    """Return the record of one grasp."""
    whole = bodex()
    return {"grasp_qpos": whole["robot_pose"][0][0][0], "obj_pose": whole["obj_pose"][0],
            "joint_names": whole["joint_names"], "obj_scale": 1.0}  # fmt: skip


def case(name: str, content: Content, expected: Any = "either", says: str = "", **files: Content) -> Hostile:
    """Return the case of a file of grasps."""
    return Hostile("grasps", name, {**scene(), "grasps.npy": content, **files}, COMMAND, expected, says)


def _draw(rng: random.Random) -> Hostile:
    whole = rng.choice((dexgraspnet, bodex, dexgraspbench))()
    way = rng.random()
    if way < 0.4:
        what, content = damaged_bytes(saved(whole), rng)
        return case(what, content)
    if way < 0.6 and isinstance(whole, dict):
        key = rng.choice([*whole])
        shapes: tuple[Any, ...] = ((), (0,), (1, 0, 3, 29), (1,) * 32, (1, 2, 3, 5), (3, 3))
        value = rng.choice((odd_values(rng), np.full(rng.choice(shapes), rng.choice((0.0, 1e30, float("nan"))))))
        return case(f"another {key}", saved({**whole, key: value}))
    what, changed = changed_value(whole, rng)
    return case(what, saved(changed if isinstance(changed, dict | list) else [changed]))


def _many(value: Any, times: int) -> Any:
    """A value that stands 10^times times in a file, and takes no room."""
    for _ in range(times):
        value = [value] * 10
    return value


class _Runs:
    def __reduce__(self) -> tuple[Any, ...]:
        return print, ("it runs",)


def handmade() -> list[Hostile]:
    """Return the cases made by hand."""
    entry, one, record = dexgraspnet()[0], bodex(), dexgraspbench()
    long, values = "a" * 10_000_000, np.zeros(1000)
    cases: dict[str, tuple[Content, str, str]] = {
        "valid DexGraspNet": (saved(dexgraspnet()), "accepted", ""),
        "valid BODex": (saved(one), "accepted", ""),
        "valid DexGraspBench": (saved(record), "accepted", ""),
        "code": (saved([_Runs()]), "refused", "may run code"),
        "only a pickle": (pickle.dumps(entry), "refused", ""),
        "numbers": (saved([1, 2]), "refused", "qpos"),
        "nothing": (saved([]), "refused", ""),
        "many entries that are one": (saved([entry] * 3_000_000), "refused", ""),
        "10^9 entries": (saved(_many(entry, 9)), "refused", ""),
        "10^9 numbers": (saved({**one, "robot_pose": _many(values, 6)}), "refused", ""),
        "10^8 scales": (saved([{**entry, "scale": _many(1.0, 8)}]), "refused", ""),
        "10^7 names": (saved({**one, "joint_names": _many("FFJ4", 7)}), "refused", ""),
        "a name of 10 MB": (saved({**one, "joint_names": [long, *one["joint_names"][1:]]}), "refused", ""),
        "a joint of markup": (saved([{**entry, "qpos": {**entry["qpos"], MARKUP: 0.0}}]), "refused", ""),
        "a joint of control characters": (saved([{**entry, "qpos": {**entry["qpos"], CONTROL: 0.0}}]), "refused", ""),
        "a NaN": (saved([{**entry, "qpos": {**entry["qpos"], "WRJTx": float("nan")}}]), "refused", ""),
        "10^30 m away": (saved([{**entry, "qpos": {**entry["qpos"], "WRJTx": 1e30}}]), "refused", ""),
        "a joint of 10^30": (saved([{**entry, "qpos": {**entry["qpos"], "FFJ4": 1e30}}]), "refused", ""),
        "a scale of 0": (saved([{**entry, "scale": 0.0}]), "refused", "scale"),
        "a scale of text": (saved([{**entry, "scale": "1"}]), "refused", "scale"),
        "a quaternion of 0": (saved({**record, "obj_pose": [0.0] * 7}), "refused", ""),
        "an object 10^300 m away": (saved({**record, "obj_pose": [1e300, 0, 0, 1, 0, 0, 0]}), "refused", "away"),
        "a scene outside": (saved({k: v for k, v in one.items() if k != "obj_pose"} | {"scene_path": "../../x"}), "refused", ""),
        "a pipe": (Pipe(), "refused", ""),
        "a device": (Link("/dev/zero"), "refused", ""),
        "10 GB of zeros": (Hole(10**10, b"\x93NUMPY\x01\x00"), "refused", ""),
        "complex numbers": (saved({**record, "grasp_qpos": np.zeros(23, dtype=complex)}), "refused", ""),
        "texts for numbers": (saved({**record, "grasp_qpos": ["0"] * 23}), "refused", ""),
    }  # fmt: skip
    return [case(name, *values) for name, values in cases.items()]


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"grasps": _draw}
