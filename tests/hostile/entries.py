"""Hostile entries of a benchmark, and hostile tasks."""

from __future__ import annotations

import io
import json
import random
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.benchmark.suite import suite_from
from dexnudge.benchmark.tasks import MANIFEST, make_tasks
from dexnudge.formats.hand_poses import palm_poses
from hostile.case import CONTROL, MARKUP, Content, Draw, Hole, Hostile, Link, Pipe, as_content, copied
from hostile.mutations import changed_value, damaged_bytes, damaged_json, odd_values

COMMAND = ("benchmark", "score", "entry", "--suite", "suite", "--out", "out", "--workers=1")
SUITE = {"name": "tiny", "version": 1, "hand": "shadow_lite", "base": False, "draws": 2, "families": ["table"],
         "seeds": [0], "objects": ["phone-200"]}  # fmt: skip
TOLD = {"name": "mine", "authors": "A. Author", "used": "nothing", "machine": "a laptop", "seconds": {}}


@cache
def made() -> tuple[dict[str, bytes], str, dict[str, Any]]:
    """Return the files of a suite of one task, the task's name, and an answer whose hands are in the table."""
    folder = Path(tempfile.mkdtemp())
    tasks = make_tasks(suite_from(SUITE, "tiny"), folder / "suite")
    q = np.zeros((2, 9 + tasks.hand.num_joints))
    q[:, 3] = q[:, 7] = 1.0
    answer = {
        "joint_names": list(tasks.hand.joint_names),
        "T_world_palm": palm_poses(q).tolist(),
        "joint_angles": q[:, 9:].tolist(),
    }
    return copied(folder), tasks.tasks[0].name, answer


def case(name: str, changed: dict[str, Content], expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of an entry with these files."""
    files, task, answer = made()
    entry = {"entry/entry.json": as_content(TOLD)}
    if not any(file.startswith("entry/answers") for file in changed):
        entry[f"entry/answers/{task}.json"] = as_content(answer)
    return Hostile("entry", name, {**files, **entry, **changed}, COMMAND, expected, says)


def packed(arrays: dict[str, Any]) -> bytes:
    """Return an npz archive."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _draw(rng: random.Random) -> Hostile:
    files, task, answer = made()
    way = rng.random()
    if way < 0.25:
        what, content = damaged_json(TOLD, rng)
        return case(f"entry: {what}", {"entry/entry.json": content})
    if way < 0.55:
        what, content = damaged_json(answer, rng)
        return case(f"answer: {what}", {f"entry/answers/{task}.json": content})
    if way < 0.65:
        arrays = {
            **answer,
            rng.choice([*answer]): rng.choice((0.0, np.zeros((0, 4, 4)), np.full((2, 4, 4), np.nan), ["a"])),
        }
        return case("answer of other arrays", {f"entry/answers/{task}.npz": packed(arrays)})
    if way < 0.75:
        what, content = damaged_bytes(packed(answer), rng)
        return case(f"archive: {what}", {f"entry/answers/{task}.npz": content})
    manifest = json.loads(files[f"suite/{MANIFEST}"])
    if way < 0.9:
        what, found = changed_value(manifest, rng)
        return case(f"manifest: {what}", {f"suite/{MANIFEST}": as_content(found)})
    key = rng.choice([*manifest])
    return case(f"manifest: another {key}", {f"suite/{MANIFEST}": as_content(manifest | {key: odd_values(rng)})})


def handmade() -> list[Hostile]:
    """Return the cases made by hand; an answer that is none counts as a failure, and the entry is judged."""
    files, task, answer = made()
    manifest, path = json.loads(files[f"suite/{MANIFEST}"]), f"entry/answers/{task}.json"
    huge = {key: np.zeros((1_000_000, 4)) for key in ("T_world_palm", "joint_angles")}
    cases: dict[str, tuple[Any, ...]] = {
        "valid": ({}, "accepted"),
        "valid npz": ({f"entry/answers/{task}.npz": packed(answer)}, "accepted"),
        "no entry": ({"entry/entry.json": Link("nothing")}, "refused"),
        "an entry that is a pipe": ({"entry/entry.json": Pipe()}, "refused"),
        "a name of markup": ({"entry/entry.json": as_content({**TOLD, "name": MARKUP})}, "refused", "name"),
        "authors of markup": ({"entry/entry.json": as_content({**TOLD, "authors": MARKUP})}, "accepted"),
        "authors of control characters": ({"entry/entry.json": as_content({**TOLD, "authors": CONTROL})}, "refused", "authors"),
        "a name that leads outside": ({"entry/entry.json": as_content({**TOLD, "name": "../../x"})}, "refused", "name"),
        "a name of dots": ({"entry/entry.json": as_content({**TOLD, "name": ".."})}, "refused", "name"),
        "NaN seconds": ({"entry/entry.json": as_content({**TOLD, "seconds": {task: float("nan")}})}, "refused"),
        "seconds of text": ({"entry/entry.json": as_content({**TOLD, "seconds": {task: "1"}})}, "refused", "seconds"),
        "an answer of NaN": ({path: as_content({**answer, "joint_angles": [[float("nan")] * 16] * 2})}, "accepted"),
        "a hand 10^30 m away": ({path: as_content({**answer, "T_world_palm": [(1e30 * np.eye(4)).tolist()] * 2})}, "accepted"),
        "joints of 10^30": ({path: as_content({**answer, "joint_angles": [[1e30] * 16] * 2})}, "accepted"),
        "1,000,000 draws": ({path: as_content({**answer, "T_world_palm": [0] * 1_000_000})}, "accepted"),
        "1,000,000 draws in an npz": ({f"entry/answers/{task}.npz": packed({**answer, **huge})}, "accepted"),
        "an answer that is a pipe": ({path: Pipe()}, "accepted"),
        "an answer that is a device": ({path: Link("/dev/zero")}, "accepted"),
        "an answer outside": ({path: Link("/etc/passwd")}, "accepted"),
        "an answer of 10 GB": ({path: Hole(10**10, b"{")}, "accepted"),
        "an answer nested 100,000 deep": ({path: b"[" * 100_000}, "accepted"),
        "an answer to another task": ({"entry/answers/else.json": as_content(answer)}, "refused", "no task"),
        "a hand outside": ({f"suite/{MANIFEST}": as_content({**manifest, "suite": {**manifest["suite"], "hand": "../../x"}})}, "either"),
        "10^12 draws": ({f"suite/{MANIFEST}": as_content({**manifest, "suite": {**manifest["suite"], "draws": 10**12}})}, "refused"),
        "a file that has changed": ({f"suite/tasks/{task}/object.obj": b""}, "refused", "manifest"),
    }  # fmt: skip
    return [case(name, *values) for name, values in cases.items()]


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"entry": _draw}
