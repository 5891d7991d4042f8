"""Triangles out of a file that may be anything: truncated, huge, hostile, or no mesh at all."""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path

import numpy as np
import trimesh

from dexnudge.errors import MeshError

FORMATS = ("obj", "stl", "ply", "glb", "off", "dae")
MAX_FACES = 200_000  # a BVH over so many is built in under a second and queried at 10^5 points a second
MAX_BYTES = 100_000_000  # 200,000 faces in the wordiest of the formats take a third of this
STL_HEADER, STL_FACE = 84, 50  # bytes of a binary STL: comment and count; one triangle

# What the parsers raise on damaged files. A defect of ours would surface in the tests of intact files.
PARSE_ERRORS = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    AssertionError,
    ArithmeticError,
    NameError,
    RuntimeError,
    SyntaxError,
    EOFError,
    struct.error,
)


def read_triangles(path: Path) -> trimesh.Trimesh:
    """All triangles of a mesh file as one unprocessed mesh in file units; possibly empty or not finite.

    No other file is opened (no materials, textures or external buffers) and XML entities are refused.

    Raises:
        MeshError: missing, empty, of an unknown format, too large, truncated or not a mesh.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise MeshError(f"{path}: unknown mesh format {path.suffix!r}; expected one of {', '.join(FORMATS)}")
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise MeshError(f"{path}: the mesh file {what}; expected a file of format {', '.join(FORMATS)}")
    size = path.stat().st_size
    if size == 0:
        raise MeshError(f"{path.name}: the mesh file is empty (0 bytes); export it again")
    if size > MAX_BYTES:
        raise MeshError(
            f"{path.name}: the mesh file has {size / 1e6:.0f} MB; expected at most {MAX_BYTES / 1e6:.0f} MB "
            f"({MAX_FACES:,} faces); decimate the mesh first"
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(
            f"{path.name}: the mesh file cannot be read ({error.strerror}); check its permissions"
        ) from error
    declared = _declared_faces(data, kind, path.name)
    if declared is not None and declared > MAX_FACES:
        raise too_many_faces(path.name, declared)
    if kind == "dae" and re.search(rb"<!\s*(DOCTYPE|ENTITY)", data, re.IGNORECASE):
        raise MeshError(f"{path.name}: the file declares XML entities (DOCTYPE); expected plain COLLADA; remove them")
    mesh = _parsed(data, kind, path.name)
    if kind in ("off", "ply") and declared is not None and len(mesh.faces) < declared:
        raise _damaged(path.name, kind, f"{declared} faces announced, {len(mesh.faces)} read")
    if len(mesh.vertices) == 0:
        raise _damaged(path.name, kind, "no triangles in it; a point cloud must be meshed first")
    if kind == "obj" and not data.endswith(b"\n") and not mesh.is_watertight:
        # An obj does not say how long it is: its last line and the vertices without a face tell.
        unused = data.count(b"\nv ") + data.startswith(b"v ") - len(np.unique(mesh.faces))
        if unused > 0:
            raise _damaged(path.name, kind, f"the last line is not ended and {unused} vertices belong to no face")
    return mesh


def _parsed(data: bytes, kind: str, name: str) -> trimesh.Trimesh:
    options = {"skip_materials": True} if kind in ("obj", "glb") else {}
    errors: tuple[type[Exception], ...] = PARSE_ERRORS
    if kind == "dae":
        from collada.common import DaeError  # type: ignore[import-untyped]

        errors = (*PARSE_ERRORS, DaeError)
    try:
        with np.errstate(all="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, **options)
            mesh = scene.to_mesh()
    except errors as error:
        raise _damaged(name, kind, f"{type(error).__name__}: {str(error)[:120]}") from error
    if not isinstance(mesh, trimesh.Trimesh):
        raise _damaged(name, kind, "no triangles in it; a point cloud must be meshed first")
    return mesh


def _damaged(name: str, kind: str, detail: str) -> MeshError:
    return MeshError(
        f"{name}: cannot be read as {kind} ({detail}); the file is truncated, damaged or not a mesh; export it again"
    )


def _declared_faces(data: bytes, kind: str, name: str) -> int | None:
    """How many faces the file announces, without parsing it; None where the format does not say."""
    if kind == "obj":
        return data.count(b"\nf ") + data.startswith(b"f ")
    if kind == "stl" and len(data) >= STL_HEADER and b"facet" not in data[:4096]:
        announced = int(struct.unpack("<I", data[STL_HEADER - 4 : STL_HEADER])[0])
        room = (len(data) - STL_HEADER) // STL_FACE
        if room < announced:
            raise _damaged(name, kind, f"{announced} faces announced, room for {room}")
        return announced
    if kind == "ply" and (match := re.search(rb"element face (\d+)", data[:4096])):
        return int(match[1])
    if kind == "off" and (match := re.match(rb"OFF\s+(?:#[^\n]*\s+)*(\d+)\s+(\d+)", data[:4096])):
        return int(match[2])
    return None


def too_many_faces(name: str, count: int) -> MeshError:
    """The error for a mesh above the limit."""
    return MeshError(
        f"{name}: the mesh has {count:,} faces; expected at most {MAX_FACES:,}, so that exact distances stay fast; "
        "decimate it first (in MeshLab: Simplification: Quadric Edge Collapse Decimation)"
    )
