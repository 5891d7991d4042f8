"""Hostile result folders: configurations, summary, and what lies beside them; none of their draws is verified."""

from __future__ import annotations

import io
import json
import random
import struct
import zipfile
from functools import cache
from typing import Any

import numpy as np

from hostile.case import CONTROL, MARKUP, Content, Draw, Hostile, Link, Pipe, as_content, copied, written
from hostile.hands import hand_files
from hostile.mutations import changed_value, damaged_bytes, damaged_json, odd_values

NPZ, SUMMARY = "r/configurations.npz", "r/summary.json"
COMMANDS = (("check", "r"), ("execute", "r", "--out", "out"), ("plan", "r", "--out", "out", "--films", "0"))
Arrays = dict[str, np.ndarray]


@cache
def data() -> dict[str, bytes]:
    """Return the files of a result of two draws that touch nothing."""
    import dexnudge as dn
    from dexnudge.results.folder import count_draws, write_configurations, write_inputs, write_summary

    folder = written(hand_files("h"))
    hand = dn.load_hand(folder / "h" / "hand.urdf")
    scene, hand = write_inputs(folder / "r", dn.build_scene("table", "phone"), hand)
    q = np.zeros((2, 9 + len(hand.joint_names)), dtype=np.float32)
    q[:, [2, 3, 7]] = 1.0
    verdicts = dn.verify(scene, hand, q)
    write_configurations(folder / "r", q, hand.joint_names, verdicts)
    details = {"criteria": [*verdicts.values], "reasons": {}, "seconds": {}, "sampler": [], "scene": scene.name}
    write_summary(folder / "r", {**count_draws(verdicts), **details, "hand": hand.name})
    return {name: content for name, content in copied(folder).items() if name.startswith("r/")}


@cache
def arrays() -> Arrays:
    """Return what configurations.npz holds."""
    return dict(np.load(io.BytesIO(data()[NPZ]), allow_pickle=False))


def npz(**changes: Any) -> bytes:
    """Return configurations.npz with other or without some (None) arrays."""
    file = io.BytesIO()
    kept = {key: value for key, value in {**arrays(), **changes}.items() if value is not None}
    np.savez_compressed(file, **kept)
    return file.getvalue()


def case(
    name: str, files: dict[str, Content], expected: Any = "either", says: str = "", *, command: int = 0
) -> Hostile:
    """Return the case of a result folder in which these files stand."""
    return Hostile("result", name, {**data(), **files}, COMMANDS[command], expected, says)


def with_entry(name: str, content: bytes, **options: Any) -> bytes:
    """Return configurations.npz with one more entry."""
    file = io.BytesIO(data()[NPZ])
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content, **options)
    return file.getvalue()


def header(text: str, after: int = 64) -> bytes:
    """Return an array whose header is this text."""
    line = text.encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(line)) + line + bytes(after)


def _encrypted() -> bytes:
    content = bytearray(data()[NPZ])
    for mark, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(mark) + place] |= 1
    return bytes(content)


def _announced(size: int) -> bytes:
    """Let the table of contents announce another size of the first entry."""
    content = bytearray(data()[NPZ])
    place = content.index(b"PK\x01\x02") + 24
    content[place : place + 4] = struct.pack("<I", size)
    return bytes(content)


def _draw(rng: random.Random) -> Hostile:
    command, which = rng.choice((0, 0, 0, 1, 2)), rng.random()
    if which < 0.3:
        what, content = damaged_bytes(data()[NPZ], rng)
        return case(f"configurations: {what}", {NPZ: content}, command=command)
    if which < 0.5:
        key = rng.choice([*arrays()])
        array = arrays()[key]
        odd = [
            None,
            array[:1],
            array[:0],
            array[None],
            array.astype("S"),
            array.astype(str),
            np.zeros_like(array),
            array.T,
        ]
        odd += [np.float64(1), np.full(2, np.nan), np.full(2, np.inf), np.array(["", MARKUP]), np.array([CONTROL, "a,b"]),
                np.zeros((2, 3), complex), np.array([1, 2]), np.array([b"a", b"b"]), np.full(array.shape, 1e300)]  # fmt: skip
        return case(f"another {key}", {NPZ: npz(**{key: rng.choice(odd)})}, command=command)
    if which < 0.8:
        summary = json.loads(data()[SUMMARY])
        if rng.random() < 0.6:
            key = rng.choice([*summary])
            what, content = f"another {key}", as_content(summary | {key: odd_values(rng)})
        else:
            what, content = damaged_json(summary, rng)
        return case(f"summary: {what}", {SUMMARY: content}, command=command)
    name = rng.choice([each for each in data() if each not in (NPZ, SUMMARY)])
    if name.endswith(".json") and rng.random() < 0.5:
        what, value = changed_value(json.loads(data()[name]), rng)
        content = as_content(value)
    else:
        what, content = damaged_bytes(data()[name], rng)
    return case(f"{name}: {what}", {name: content}, command=command)


def handmade() -> list[Hostile]:
    """Return the cases made by hand."""
    summary, q = json.loads(data()[SUMMARY]), arrays()["q"]
    zip_of_pipes = with_entry("../../../../tmp/x.npy", b"")
    cases: dict[str, tuple[Any, ...]] = {
        "valid": ({}, "accepted"),
        "an entry of 3 GB": ({NPZ: with_entry("more.npy", header("{'descr': '|u1', 'fortran_order': False, 'shape': (3000000000,), }", 300_000_000))}, "refused"),
        "an entry of 300 MB": ({NPZ: with_entry("more.npy", header("{'descr': '|u1', 'fortran_order': False, 'shape': (300000000,), }", 300_000_000))}, "refused"),
        "a size of 4 GB announced": ({NPZ: _announced(2**32 - 2)}, "refused"),
        "a size of 1 announced": ({NPZ: _announced(1)}, "refused"),
        "a header that is none": ({NPZ: with_entry("more.npy", header("nonsense"))}, "refused"),
        "a header that calls": ({NPZ: with_entry("more.npy", header("__import__('os').system('ls')"))}, "refused"),
        "a header of brackets": ({NPZ: with_entry("more.npy", header("(" * 60_000))}, "refused"),
        "a shape below 0": ({NPZ: with_entry("more.npy", header("{'descr': '<f8', 'fortran_order': False, 'shape': (-8,), }"))}, "refused"),
        "a shape of 10^400": ({NPZ: with_entry("more.npy", header("{'descr': '<f8', 'fortran_order': False, 'shape': (" + "9" * 400 + ",), }"))}, "refused"),
        "objects": ({NPZ: npz(reasons=np.array([{}, []], dtype=object))}, "refused", "pickled"),
        "encrypted": ({NPZ: _encrypted()}, "refused"),
        "no draws": ({NPZ: npz(**{key: value[:0] for key, value in arrays().items() if key != "joint_names"})}, "refused"),
        "an entry that leads outside": ({NPZ: zip_of_pipes}, "refused"),
        "10,000 entries": ({NPZ: npz(**{f"x{i}": np.zeros(2) for i in range(10_000)})}, "refused"),
        "q of NaN": ({NPZ: npz(q=np.full_like(q, np.nan))}, "refused", "q"),
        "q of 1e30": ({NPZ: npz(q=np.full_like(q, 1e30))}, "either"),
        "q of zeros": ({NPZ: npz(q=np.zeros_like(q))}, "either"),
        "an honest success that is none": ({NPZ: npz(success=np.array([True, True]), reasons=np.array(["", ""]))}, "refused", ""),
        "links with a comma": ({NPZ: npz(contact_links=np.array(["a\\,b", "c"]))}, "refused", "contact_links"),
        "links that end in a backslash": ({NPZ: npz(contact_links=np.array(["a\\", "\\\\,\\"]))}, "refused", ""),
        "a text that is no character": ({NPZ: npz(reasons=np.array([0x110000, 0x110000], dtype=np.uint32).view("U1"))}, "refused"),
        "a criterion of control characters": ({NPZ: npz(**{CONTROL: np.zeros(2)}), SUMMARY: as_content(summary | {"criteria": [*summary["criteria"], CONTROL]})}, "either"),
        "a criterion that leads outside": ({NPZ: npz(**{"../x": np.zeros(2)}), SUMMARY: as_content(summary | {"criteria": [*summary["criteria"], "../x"]})}, "either"),
        "a criterion of 100,000 letters": ({NPZ: npz(**{"a" * 60_000: np.zeros(2)}), SUMMARY: as_content(summary | {"criteria": [*summary["criteria"], "a" * 60_000]})}, "either"),
        "criteria of objects": ({SUMMARY: as_content(summary | {"criteria": [{}, []]})}, "refused", ""),
        "reasons of numbers": ({SUMMARY: as_content(summary | {"reasons": {"contact": 5}})}, "either", ""),
        "a summary of NaN": ({SUMMARY: as_content(summary | {"drawn": float("nan")})}, "refused"),
        "an integer of 400 digits": ({SUMMARY: as_content(summary | {"drawn": 10**400})}, "refused"),
        "an integer of 5,000 digits": ({SUMMARY: b'{"drawn": ' + b"9" * 5000 + b"}"}, "refused"),
        "a summary nested 100,000 deep": ({SUMMARY: b"[" * 100_000}, "refused"),
        "a key twice": ({SUMMARY: data()[SUMMARY].rstrip()[:-1] + b', "drawn": 2}'}, "refused", "twice"),
        "a pipe": ({NPZ: Pipe()}, "refused"),
        "a device": ({NPZ: Link("/dev/zero")}, "refused"),
        "a summary that is a pipe": ({SUMMARY: Pipe()}, "refused"),
    }  # fmt: skip
    made = [case(f"{name}, check", *values) for name, values in cases.items()]
    made += [
        case(f"{name}, {COMMANDS[command][0]}", cases[name][0], command=command)
        for command in (1, 2)
        for name in ("an entry of 3 GB", "q of zeros", "reasons of numbers", "a pipe")
    ]
    return made


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"result": _draw}
