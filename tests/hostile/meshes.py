"""Hostile meshes: objects and surroundings in every format that is read."""

from __future__ import annotations

import json
import random
import re
import struct
from functools import cache
from typing import Any, Literal

import numpy as np
import trimesh

from hostile.case import CONTROL, MARKUP, MISSING_HAND, Content, Draw, Hole, Hostile, Link, Pipe
from hostile.mutations import damaged_bytes, damaged_json, damaged_xml

FORMATS = ("obj", "stl", "ply", "glb", "off", "dae")
SCENE = ("--scene", "table", "--hand", MISSING_HAND, "--out", "out")
OWN = ("--object-pose", "pose.json", "--motion", "1", "0", "0", "--hand", MISSING_HAND, "--out", "out")
POSE = b"[[1,0,0,0],[0,1,0,0],[0,0,1,0.006],[0,0,0,1]]"


@cache
def valid(kind: str, *, ascii_text: bool = False) -> bytes:
    """Return a slab with a hole, 0.15 m long, as a file."""
    mesh = trimesh.creation.annulus(0.02, 0.075, 0.012)
    mesh.apply_scale((1.0, 0.5, 1.0))
    if kind == "glb":
        mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    options = {"encoding": "ascii"} if ascii_text and kind == "ply" else {}
    data = mesh.export(file_type="stl_ascii" if ascii_text and kind == "stl" else kind, **options)
    data = data.encode() if isinstance(data, str) else data
    if kind == "dae":  # with names and times that are the same in every run
        names: dict[bytes, bytes] = {}
        data = re.sub(rb"[0-9a-f]{32}", lambda found: names.setdefault(found[0], b"id%d" % len(names)), data)
        data = re.sub(rb"20[0-9-]+T[0-9:.]+", b"2026-01-01T00:00:00", data).replace(b"Y_UP", b"Z_UP")
    return data


@cache
def table_top() -> bytes:
    """Return a slab of surroundings as PLY."""
    slab = trimesh.creation.box((0.6, 0.6, 0.05))
    slab.apply_translation((0, 0, -0.025))
    return slab.export(file_type="ply")


def mesh_case(kind: str, name: str, data: Content, expected: Any = "either", says: str = "", file: str = "") -> Hostile:
    """Return the case of a command that reads an object's mesh."""
    file = file or f"object.{kind}"
    return Hostile(kind, name, {file: data}, ("scene", file, *SCENE), expected, says)


def _drawn(kind: str) -> Draw:
    def draw(rng: random.Random) -> Hostile:
        data = valid(kind, ascii_text=kind in ("stl", "ply") and rng.random() < 0.5)
        if kind == "glb" and rng.random() < 0.7:
            what, data = _changed_glb(data, rng)
        elif kind == "dae" and rng.random() < 0.7:
            what, data = damaged_xml(data, rng, ("#mesh", "VERTEX", "10000000"))
        else:
            what, data = damaged_bytes(data, rng)
        return mesh_case(kind, what, data)

    return draw


def glb(content: Any, binary: bytes = b"") -> bytes:
    """Return a binary glTF of this JSON (or its text) and this buffer."""
    text = content if isinstance(content, bytes) else json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def glb_parts(data: bytes) -> tuple[Any, bytes]:
    """Return the JSON and the buffer of a binary glTF."""
    length = struct.unpack("<I", data[12:16])[0]
    return json.loads(data[20 : 20 + length]), data[20 + length + 8 :]


def _changed_glb(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    content, binary = glb_parts(data)
    what, text = damaged_json(content, rng)
    return what, glb(text, binary)


def _surroundings(rng: random.Random) -> Hostile:
    kind = rng.choice(FORMATS)
    what, data = damaged_bytes(table_top() if kind == "ply" else valid(kind), rng)
    files = {f"room.{kind}": data, "pose.json": POSE}
    return Hostile("environment", f"{kind}: {what}", files, ("scene", "phone", "--environment", f"room.{kind}", *OWN))


def _sized_glb(**changes: Any) -> bytes:
    content, binary = glb_parts(valid("glb"))
    return glb(content | changes, binary)


def _many_nodes() -> bytes:
    content, binary = glb_parts(valid("glb"))
    content |= {"nodes": [{"mesh": 0}] * 500_000, "scenes": [{"nodes": list(range(500_000))}]}
    return glb(content, binary)


def _doubling_nodes() -> bytes:
    content, binary = glb_parts(valid("glb"))
    nodes: list[Any] = [{"children": [number + 1, number + 1]} for number in range(40)]
    content |= {"nodes": [*nodes, {"mesh": 0}], "scenes": [{"nodes": [0]}]}
    return glb(content, binary)


def _accessors(**changes: Any) -> bytes:
    content, binary = glb_parts(valid("glb"))
    for accessor in content["accessors"]:
        accessor.update(changes)
    return glb(content, binary)


def _obj(line: str, *, instead: str = "") -> bytes:
    text = valid("obj").decode()
    return (text.replace(instead, line, 1) if instead else f"{text}{line}\n").encode()


def _dae(old: str, new: str) -> bytes:
    text = valid("dae").decode()
    assert old in text, old
    return text.replace(old, new, 1).encode()


BOX = "v 0 0 0\nv .1 0 0\nv .1 .05 0\nv 0 .05 0\nv 0 0 .01\nv .1 0 .01\nv .1 .05 .01\nv 0 .05 .01\n"
QUADS = "f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
PLY = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n{}end_header\n{}"
FACE = "element face {}\nproperty list uchar int vertex_indices\n"


def _instances() -> bytes:
    """Return a COLLADA of 30 nodes, each of which places the next twice."""
    nodes = "".join(
        f'<node id="n{i}"><instance_node url="#n{i + 1}"/><instance_node url="#n{i + 1}"/></node>' for i in range(30)
    )
    nodes += '<node id="n30"><instance_geometry url="#id1"/></node>'
    data = _dae("<library_visual_scenes>", f"<library_nodes>{nodes}</library_nodes><library_visual_scenes>")
    return data.replace(b'<node id="node0" name="node0">', b'<node id="node0"><instance_node url="#n0"/>', 1)


def _handmade(kind: str, cases: dict[str, tuple[Content, str]]) -> list[Hostile]:
    return [mesh_case(kind, name, data, expected) for name, (data, expected) in cases.items()]


Expected = Literal["refused", "accepted", "either"]
HANDMADE = [
    *(mesh_case(kind, "valid", valid(kind), "accepted") for kind in FORMATS),
    *(mesh_case(kind, "empty", b"", "refused", "empty") for kind in FORMATS),
    *(mesh_case(kind, "only whitespace", b" \n" * 50, "refused") for kind in FORMATS),
    *(mesh_case(kind, "a pipe", Pipe(), "refused") for kind in FORMATS),
    mesh_case("stl", "a link to a device", Link("/dev/zero"), "refused"),
    mesh_case("stl", "a link to itself", Link("object.stl"), "refused"),
    mesh_case("stl", "in a folder of 300 letters", Link("a" * 200 + "/" + "b" * 200), "refused"),
    mesh_case("obj", "markup in the file's name", valid("obj"), "accepted", file=f"a{MARKUP.replace('/', '')}.obj"),
    mesh_case("obj", "control characters in the file's name", valid("obj"), "accepted", file=f"a{CONTROL}.obj"),
    mesh_case("obj", "a file's name that is not UTF-8", valid("obj"), "accepted", file="a\udcff.obj"),
    *_handmade(
        "obj",
        {
            "quads": ((BOX + QUADS).encode(), "accepted"),
            "a vertex of two numbers": (_obj("v 1 2"), "refused"),
            "a vertex of NaN": ((BOX.replace(".05", "nan", 1) + QUADS).encode(), "refused"),
            "a vertex at 1e300": ((BOX.replace(".05", "1e300", 1) + QUADS).encode(), "refused"),
            "a vertex at 1e400": ((BOX.replace(".05", "1e400", 1) + QUADS).encode(), "refused"),
            "a part 1e12 m away": (_obj("v 1e12 0 0\nv 1e12 1 0\nv 1e12 0 1\nf -1 -2 -3"), "refused"),
            "face index 0": ((BOX + QUADS + "f 0 1 2\n").encode(), "refused"),
            "face index 0 behind a slash": ((BOX + QUADS + "f 1/0 2/0 3/0\n").encode(), "either"),
            "face index 0 after a tab": ((BOX + QUADS + "f\t1 0 2\n").encode(), "refused"),
            "face index far below 0": ((BOX + QUADS + "f -9 -8 -7\n").encode(), "refused"),
            "face index too large": ((BOX + QUADS + "f 1 2 9\n").encode(), "refused"),
            "face index of 400 digits": ((BOX + QUADS + f"f 1 2 {'9' * 400}\n").encode(), "refused"),
            "face index 2^32 + 1": ((BOX + QUADS + f"f 1 2 {2**32 + 3}\n").encode(), "refused"),
            "face index 1.5": ((BOX + QUADS + "f 1 2 3.5\n").encode(), "refused"),
            "a face of 20,000 corners": ((BOX + QUADS + "f" + " 1 2 3 4" * 5000 + "\n").encode(), "either"),
            "a face of two corners": ((BOX + QUADS + "f 1 2\n").encode(), "either"),
            "decimal commas": ((BOX.replace(".", "0,") + QUADS).encode(), "refused"),
            "hexadecimal numbers": ((BOX.replace(".1", "0x1", 1) + QUADS).encode(), "refused"),
            "spaces in the way": (b"v 0 0 0 \n  v .1 0 0\n\tv 0 .1 0\nv 0 0 .1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4", "either"),
            "free-form curves": ((BOX + QUADS + "vp 1 2\ncurv 0 1 1 2\nsurf 0 1 0 1 1 2 3\nend\n").encode(), "accepted"),
            "90,000 quads that are lines": ((BOX + "l 1 2 3 4\n" * 90_000 + QUADS).encode(), "accepted"),
            "grouped digits": ((BOX.replace(".1", "0_1.1", 1) + QUADS).encode(), "refused"),
            "a material elsewhere": (("mtllib /etc/passwd\nmtllib ../../x.mtl\n" + BOX + QUADS).encode(), "accepted"),
            "names of markup": ((f"o {MARKUP}\ng {MARKUP}\n" + BOX + QUADS).encode(), "accepted"),
            "a line of 5 MB": (("# " + "x" * 5_000_000 + "\n" + BOX + QUADS).encode(), "accepted"),
            "a line of 5 MB that is wrong": (("v " + "x" * 5_000_000 + "\n" + BOX + QUADS).encode(), "refused"),
            "5 MB of line continuations": ((BOX + "\\\n" * 2_500_000 + QUADS).encode(), "either"),
            "100,000 objects": ((BOX + QUADS + "o a\n" * 100_000).encode(), "either"),
            "100,000 objects of one face": ((BOX + QUADS + "o a\nf 1 2 3\n" * 50_000).encode(), "either"),
            "Arabic digits": ((BOX.replace(".1", "٣", 1) + QUADS).encode(), "refused"),
        },
    ),
    *_handmade(
        "stl",
        {
            "4 billion faces announced": (bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(500), "refused"),
            "no faces": (bytes(84), "refused"),
            "NaN": (valid("stl")[:100] + struct.pack("<f", np.nan) + valid("stl")[104:], "refused"),
            "infinity": (valid("stl")[:100] + struct.pack("<f", np.inf) + valid("stl")[104:], "refused"),
            "ASCII without its end": (valid("stl", ascii_text=True)[:-2000], "refused"),
            "ASCII in capitals": (valid("stl", ascii_text=True).upper(), "accepted"),
            "a word for a number": (valid("stl", ascii_text=True).replace(b"vertex 0", b"vertex x", 1), "refused"),
            "two bodies": (valid("stl", ascii_text=True) * 2, "either"),
            "facets of four corners": (valid("stl", ascii_text=True).replace(b"endloop", b"vertex 0 0 0\nendloop", 1), "refused"),
        },
    ),
    *_handmade(
        "ply",
        {
            "a header of 5 kB": (valid("ply").replace(b"element", b"comment " + b"x" * 5000 + b"\nelement", 1), "accepted"),
            "a header without an end": (b"ply\nformat ascii 1.0\n" + b"comment x\n" * 200_000, "refused"),
            "1e9 vertices announced": (PLY.format(10**9, FACE.format(1), "0 0 0\n").encode(), "refused"),
            "1e18 faces announced": (PLY.format(3, FACE.format(10**18), "0 0 0\n" * 3).encode(), "refused"),
            "faces of -1 corners": (PLY.format(3, FACE.format(1), "0 0 0\n" * 3 + "-1 0 1 2\n").encode(), "refused"),
            "a corner that is not there": (PLY.format(3, FACE.format(1), "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n").encode(), "refused"),
            "negative corners": (PLY.format(3, FACE.format(1), "0 0 0\n1 0 0\n0 1 0\n3 -1 -2 -3\n").encode(), "refused"),
            "a point cloud": (PLY.format(3, "", "0 0 0\n1 0 0\n0 1 0\n").encode(), "refused"),
            "no type of that name": (valid("ply").replace(b"property float x", b"property quux x", 1), "refused"),
            "a list of lists": (valid("ply").replace(b"property list uchar int", b"property list list list", 1), "refused"),
        },
    ),
    *_handmade(
        "off",
        {
            "1e9 vertices announced": (b"OFF\n1000000000 1 0\n0 0 0\n", "refused"),
            "1e18 faces announced": (b"OFF\n3 1000000000000000000 0\n0 0 0\n", "refused"),
            "a corner that is not there": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", "refused"),
            "a negative corner": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "refused"),
            "faces of two corners": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "refused"),
            "negative counts": (b"OFF\n-3 -1 0\n0 0 0\n", "refused"),
            "NaN": (valid("off").replace(b" 0.0", b" nan", 1), "refused"),
        },
    ),
    *_handmade(
        "glb",
        {
            "1e9 zeros announced": (_accessors(count=10**9), "refused"),
            "a count of text": (_accessors(count="many"), "refused"),
            "a count below 0": (_accessors(count=-1), "refused"),
            "a stride of 0": (_accessors(byteStride=0), "either"),
            "an offset behind the end": (_accessors(byteOffset=10**9), "refused"),
            "no type of that name": (_accessors(componentType=9), "refused"),
            "500,000 copies of a mesh": (_many_nodes(), "refused"),
            "2^40 copies by doubling": (_doubling_nodes(), "refused"),
            "a node below itself": (_sized_glb(nodes=[{"children": [0], "mesh": 0}], scenes=[{"nodes": [0]}]), "refused"),
            "a buffer elsewhere": (_sized_glb(buffers=[{"uri": "/etc/passwd", "byteLength": 100}]), "either"),
            "a buffer on the web": (_sized_glb(buffers=[{"uri": "http://127.0.0.1:9/", "byteLength": 100}]), "either"),
            "a matrix of NaN": (_sized_glb(nodes=[{"mesh": 0, "matrix": [float("nan")] * 16}]), "refused"),
            "a matrix of zeros": (_sized_glb(nodes=[{"mesh": 0, "matrix": [0] * 16}]), "refused"),
            "a scale of 1e300": (_sized_glb(nodes=[{"mesh": 0, "scale": [1e300] * 3}]), "refused"),
            "a rotation of zeros": (_sized_glb(nodes=[{"mesh": 0, "rotation": [0] * 4}]), "either"),
            "names of markup": (_sized_glb(nodes=[{"mesh": 0, "name": MARKUP}]), "accepted"),
            "JSON nested 100,000 deep": (glb(b"[" * 100_000 + b"]" * 100_000), "refused"),
            "an extension it needs": (_sized_glb(extensionsRequired=[CONTROL]), "refused"),
            "an integer of 5,000 digits": (glb(b'{"accessors": [{"count": ' + b"9" * 5000 + b"}]}"), "refused"),
            "a sparse accessor": (_accessors(sparse={"count": 10**9, "indices": {}, "values": {}}), "refused"),
        },
    ),
    *_handmade(
        "dae",
        {
            "NaN": (valid("dae").replace(b"0.075", b"nan", 1), "refused"),
            "an entity": (_dae("<COLLADA", '<!DOCTYPE x [<!ENTITY a "b">]><COLLADA'), "refused"),
            "an external entity": (_dae("<COLLADA", '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><COLLADA'), "refused"),
            "copies by doubling": (_instances(), "refused"),
            "UTF-16": (valid("dae").decode().encode("utf-16"), "refused"),
            "a unit of 0": (_dae("<asset>", '<asset><unit name="x" meter="0"/>'), "either"),
            "elements nested 100,000 deep": (_dae("<asset>", "<asset>" + "<a>" * 100_000 + "</a>" * 100_000), "either"),
            "names of markup": (_dae('name="node0"', 'name="&lt;script&gt;alert(1)&lt;/script&gt;"'), "accepted"),
        },
    ),
    *(mesh_case(kind, "a hole of 95 MB", Hole(95_000_000, valid(kind)[:200]), "refused") for kind in FORMATS),
    *(mesh_case(kind, "a hole of 10 GB", Hole(10**10, valid(kind)[:200]), "refused") for kind in FORMATS),
    Hostile("environment", "a hole of 900 MB", {"room.ply": Hole(900_000_000, valid("ply")[:200]), "pose.json": POSE},
            ("scene", "phone", "--environment", "room.ply", *OWN), "refused"),
    Hostile("environment", "valid", {"room.ply": table_top(), "pose.json": POSE},
            ("scene", "phone", "--environment", "room.ply", *OWN), "accepted"),
]  # fmt: skip

DRAWS: dict[str, Draw] = {**{kind: _drawn(kind) for kind in FORMATS}, "environment": _surroundings}
