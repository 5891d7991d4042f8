"""What a mesh file announces, read before a parser sees it: too much, what is not supported, up axis and unit.

Parsers believe what a file says: a glTF of 200 bytes can ask for gigabytes, a COLLADA of 6 kB for a million copies.
"""

from __future__ import annotations

import codecs
import json
import re
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dexnudge.errors import MeshError

MAX_FACES = 200_000  # of an object or a link: a BVH over so many is built in under a second
MAX_SURROUNDINGS_FACES = 2_000_000  # of a scanned room: read, repaired and prepared in some ten seconds
MAX_PARTS = 10_000  # copies of meshes that a scene graph may place
MAX_NODES = 200_000  # visited when every reference is followed, with or without a mesh
MAX_DEPTH = 100  # nodes above one another in a scene graph
STL_HEADER, STL_FACE = 84, 50  # bytes of a binary STL: comment and count; one triangle
PLY_HEADER = 1_000_000  # bytes in which a PLY's header must end
PLY_TYPES = dict(zip(b"char uchar short ushort int uint float double".split(), "bBhHiIfd", strict=True))
PLY_TYPES |= dict(zip(b"int8 uint8 int16 uint16 int32 uint32 float32 float64".split(), "bBhHiIfd", strict=True))
COMPRESSIONS = {"KHR_draco_mesh_compression": "Draco", "EXT_meshopt_compression": "meshopt"}
ASCII_COMPATIBLE = ("utf-8", "us-ascii", "ascii", "iso-8859-1", "latin-1", "windows-1252")


@dataclass(frozen=True)
class Announced:
    """A file's bytes as the parser shall read them, how many faces they announce, the axis that is up, metres a unit.

    `up` is "x", "y" or "z", or "" where a file that should say it does not.
    """

    data: bytes
    faces: int | None = None
    up: str = "z"
    unit: float | None = None


def damaged(name: str, kind: str, detail: str) -> MeshError:
    """Return the error for a file that is not what its name says."""
    return MeshError(
        f"{name}: cannot be read as {kind} ({detail}); the file is truncated, damaged or not a mesh; export it again"
    )


def too_many_faces(name: str, count: int, limit: int) -> MeshError:
    """Return the error for a mesh above the limit."""
    return MeshError(
        f"{name}: the mesh has {count:,} faces; expected at most {limit:,}, so that exact distances stay fast; "
        "decimate it first (in MeshLab: Simplification: Quadric Edge Collapse Decimation)"
    )


def announced(data: bytes, kind: str, name: str, *, max_faces: int = MAX_FACES) -> Announced:
    """Look at a file before it is parsed.

    Raises:
        MeshError: more faces or parts than the limits, a compression or an encoding that is not read, XML entities, or
            numbers that cannot be meant.
    """
    if kind not in ("glb", "dae") and data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) and b"\0" in data[2:100]:
        raise damaged(name, kind, "it is in UTF-16; expected text in UTF-8")
    found = _GUARDS[kind](data, name)
    if found.faces is not None and found.faces > max_faces:
        raise too_many_faces(name, found.faces, max_faces)
    return found


def _ascii(data: bytes) -> bytes:
    """Return text in which only names and comments can hold other characters, without them, its lines ended by newlines."""
    data = data if b"\r" not in data else data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data if data.isascii() else data.decode("latin-1").encode("ascii", "replace")


def _obj(data: bytes, name: str) -> Announced:
    text = _ascii(data)
    text = text.replace(b"\\\n", b" ")  # a line that goes on in the next one
    for line, fault in (
        (rb"^[ \t]*[vf](?:[ \t]+[^\s#]+){0,2}[ \t]*(?:#.*)?\r?$", "fewer than three numbers"),
        (rb"^[ \t]*f[ \t](?:[^\n#]*[ \t])?[+-]?0+(?:[/\s][^\n]*)?$", "an index 0, though the first vertex has 1"),
    ):
        if match := re.search(line, text, re.MULTILINE):
            raise damaged(name, "obj", f"the line '{match[0].decode().strip()[:60]}' has {fault}")
    if re.search(rb"^f[ \t][^\n]*-", text, re.MULTILINE):
        text = _absolute_indices(text, name)
    return Announced(text, text.count(b"\nf ") + text.startswith(b"f "))


def _absolute_indices(text: bytes, name: str) -> bytes:
    """Return an OBJ whose faces count vertices from the first one, where some counted backwards from the last."""
    counts, lines = {b"v": 0, b"vt": 0, b"vn": 0}, []

    def absolute(corner: bytes) -> bytes:
        parts = zip(corner.split(b"/"), counts.values(), strict=False)
        return b"/".join(b"%d" % first(part, count) if part[:1] == b"-" else part for part, count in parts)

    def first(part: bytes, count: int) -> int:
        if not re.fullmatch(rb"-\d{1,18}", part) or count + int(part) < 0:
            raise damaged(name, "obj", f"a face names vertex {part.decode()[:60]}, but {count} stand before it")
        return count + 1 + int(part)

    for line in text.split(b"\n"):
        words = line.split()
        if words and words[0] in counts:
            counts[words[0]] += 1
        lines.append(b"f " + b" ".join(map(absolute, words[1:])) if words[:1] == [b"f"] and b"-" in line else line)
    return b"\n".join(lines)


def _stl(data: bytes, name: str) -> Announced:
    count = int(struct.unpack("<I", data[STL_HEADER - 4 : STL_HEADER])[0]) if len(data) >= STL_HEADER else 0
    end = STL_HEADER + STL_FACE * count
    if len(data) < STL_HEADER or (end != len(data) and b"facet" in data[:4096].lower()):
        if match := re.search(rb"vertex(?!(?:[ \t]+[^\s]+){3}[ \t]*[\r\n])[^\n]*", data, re.IGNORECASE):
            raise damaged(name, "stl", f"the line '{match[0].decode('latin-1').strip()[:60]}' has not three numbers")
        return Announced(_ascii(data), data.lower().count(b"endfacet"))
    if end > len(data):
        room = (len(data) - STL_HEADER) // STL_FACE
        raise damaged(name, "stl", f"{count} faces announced, room for {room}")
    return Announced(data[:end], count)  # some programs write a colour table or a signature behind the last triangle


def _ply(data: bytes, name: str) -> Announced:  # noqa: ARG001 - as the others
    end = data.find(b"end_header", 0, PLY_HEADER)
    header = data[: end if end >= 0 else PLY_HEADER]
    count = re.search(rb"element\s+face\s+(\d{1,18})", header)
    faces = int(count[1]) if count else None
    if re.search(rb"format\s+ascii", header):
        return Announced(_ascii(data), faces)
    return Announced(_ascii(header) + data[len(header) : _ply_end(header, data)], faces)


def _ply_end(header: bytes, data: bytes) -> int:
    """Return where the last element that a binary PLY announces ends: some programs write more behind it.

    The file's length where that cannot be told, or the file is shorter.
    """
    end, order = data.find(b"\n", len(header)) + 1, "<" if b"little" in header else ">"
    elements: list[tuple[int, list[list[struct.Struct]]]] = []
    try:
        for words in map(bytes.split, header.splitlines()):
            if words[:1] == [b"element"]:
                elements.append((int(words[2]), []))
            elif words[:1] == [b"property"]:
                types = words[2:4] if words[1] == b"list" else words[1:2]
                elements[-1][1].append([struct.Struct(order + PLY_TYPES[each]) for each in types])
        sizes = [sum(first.size + sum(3 * item.size for item in items) for first, *items in row) for _, row in elements]
        if end + sum(count * size for (count, _), size in zip(elements, sizes, strict=True)) == len(data):
            return len(data)  # all lists are triangles
        for (count, row), size in zip(elements, sizes, strict=True):
            if all(len(types) == 1 for types in row):
                end += count * size
                continue
            if count > MAX_SURROUNDINGS_FACES:
                return len(data)
            for _ in range(count):
                for first, *items in row:
                    end += first.size + sum(item.size * max(0, first.unpack_from(data, end)[0]) for item in items)
    except (LookupError, ValueError, struct.error):
        return len(data)
    return min(end, len(data))


def _off(data: bytes, name: str) -> Announced:  # noqa: ARG001 - as the others
    data = re.sub(rb"\A\s*(?:OFF(?=\s)[ \t]*\n?)?(?=(?:\s*#[^\n]*\n)*\s*\d)", b"OFF\n", data, flags=re.IGNORECASE)
    count = re.match(rb"OFF\s+(?:#[^\n]*\s+)*(\d{1,18})\s+(\d{1,18})", data[:4096])
    return Announced(_ascii(data), int(count[2]) if count else None)


def _glb(data: bytes, name: str) -> Announced:
    try:
        content = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
        for extension in content.get("extensionsRequired", ()):
            raise MeshError(
                f"{name}: the file needs the glTF extension {extension}, which is not read; "
                f"expected plain triangles; export it without {COMPRESSIONS.get(extension, extension)}"
            )
        counts = [accessor["count"] for accessor in content.get("accessors", ())]
        if max(counts, default=0) > len(data):
            raise damaged(
                name, "glb", f"an accessor announces {max(counts):,} values, the file has {len(data):,} bytes"
            )
        if any("sparse" in accessor for accessor in content.get("accessors", ())):
            raise MeshError(
                f"{name}: the file has sparse accessors; expected plain ones; export it without morph targets"
            )
        children: dict[Any, Any] = {}
        for number, node in enumerate(content.get("nodes", ())):
            children[number] = [*node.get("children", ()), *([("mesh", node["mesh"])] if "mesh" in node else [])]
        for number, mesh in enumerate(content.get("meshes", ())):
            used = [each.get("indices", each["attributes"].get("POSITION")) for each in mesh["primitives"]]
            children["mesh", number] = sum(counts[accessor] // 3 for accessor in used if accessor is not None)
        roots = [node for scene in content.get("scenes", ()) for node in scene.get("nodes", ())]
        return Announced(data, _faces_of_graph(roots, children, name, "glb"), up="y")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, struct.error) as error:
        if isinstance(error, MeshError):
            raise
        raise damaged(name, "glb", f"{type(error).__name__}: {str(error)[:120]}") from error


def _utf_8(data: bytes) -> bytes:
    """Return text in UTF-8 as it is, and any other as if it were in Latin-1: numbers are the same in both."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode("utf-8")
    return data


def _dae(data: bytes, name: str) -> Announced:
    declared = re.search(rb"<\?xml[^>]*encoding\s*=\s*[\"']([^\"']+)", data[:200])
    encoding = declared[1].decode("ascii", "replace").lower() if declared else "utf-8"
    if b"\0" in data[:1000] or data[:2] in (b"PK", b"\x1f\x8b") or encoding not in ASCII_COMPATIBLE:
        kind = "compressed" if data[:2] in (b"PK", b"\x1f\x8b") else f"in {encoding if declared else 'UTF-16'}"
        raise damaged(name, "dae", f"it is {kind}; expected XML in UTF-8")
    if re.search(rb"<!\s*(DOCTYPE|ENTITY)", data, re.IGNORECASE):
        raise MeshError(f"{name}: the file declares XML entities (DOCTYPE); expected plain COLLADA; remove them")
    try:
        data = _utf_8(data) if encoding == "utf-8" else data
        root = ElementTree.fromstring(data)  # noqa: S314 - entities were refused
        for element in root.iter():
            element.tag = str(element.tag).rpartition("}")[2]
        for array in root.iter("float_array"):
            if not np.isfinite(np.array((array.text or "").split(), dtype=np.float64)).all():
                raise MeshError(f"{name}: a float_array holds NaN or infinity; expected numbers; export the mesh again")
        children: dict[Any, Any] = {}
        for geometry in root.iter("geometry"):
            primitives = [each for kind in ("triangles", "polylist", "polygons") for each in geometry.iter(kind)]
            children["#" + geometry.get("id", "")] = sum(int(each.get("count", 0)) for each in primitives)
        for node in [*root.iter("node"), *root.iter("visual_scene")]:
            below = [child for child in node if child.tag == "node"]
            urls = [child.get("url") for child in node if child.tag in ("instance_geometry", "instance_node")]
            children[node] = [*below, *urls]
            children.setdefault("#" + node.get("id", ""), [node])
        faces = _faces_of_graph(list(root.iter("visual_scene")), children, name, "dae")
        unit, up = root.find("asset/unit"), root.findtext("asset/up_axis", "").strip()
        metres = float(unit.get("meter", 1)) if unit is not None else None
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        if isinstance(error, MeshError):
            raise
        raise damaged(name, "dae", f"{type(error).__name__}: {str(error)[:120]}") from error
    if metres is not None and not 0 < metres < np.inf:
        raise MeshError(f"{name}: its unit is {metres} m; expected a length; mend <unit meter=...>")
    if up not in ("", "X_UP", "Y_UP", "Z_UP"):
        raise MeshError(f"{name}: its up axis is {up[:20]!r}; expected X_UP, Y_UP or Z_UP; mend <up_axis>")
    return Announced(data, faces, up=up[:1].lower(), unit=metres)


def _faces_of_graph(roots: list[Any], children: dict[Any, Any], name: str, kind: str) -> int:
    """Return the number of faces when every reference in a scene graph is followed; a leaf is its number of faces."""
    sizes: dict[Any, tuple[int, int, int]] = {}

    def size(node: Any, depth: int) -> tuple[int, int, int]:
        if depth > MAX_DEPTH:
            raise damaged(name, kind, f"nodes more than {MAX_DEPTH} deep, or below themselves")
        below = children.get(node, ())
        if node not in sizes:
            parts = [(below, 1, 1)] if isinstance(below, int) else [size(child, depth + 1) for child in below]
            counts = [sum(part[k] for part in parts) for k in range(3)]
            sizes[node] = counts[0], counts[1], counts[2] + 1
        return sizes[node]

    faces, parts, nodes = (sum(values) for values in zip((0, 0, 0), *(size(root, 0) for root in roots), strict=True))
    if nodes > MAX_NODES:
        raise MeshError(f"{name}: the file places {nodes:,} nodes; expected at most {MAX_NODES:,}; join them")
    if parts > MAX_PARTS:
        raise MeshError(
            f"{name}: the file places {parts:,} copies of meshes; expected at most {MAX_PARTS:,}; join them"
        )
    return faces


_GUARDS: dict[str, Callable[[bytes, str], Announced]] = {
    "obj": _obj,
    "stl": _stl,
    "ply": _ply,
    "glb": _glb,
    "off": _off,
    "dae": _dae,
}
