"""Triangles out of a file that may be anything: truncated, huge, hostile, or no mesh at all."""

from __future__ import annotations

import io
import logging
import re
import struct
from pathlib import Path

import numpy as np
import trimesh

from dexnudge.errors import MeshError
from dexnudge.geometry.mesh_guards import MAX_FACES, announced, damaged

FORMATS = ("obj", "stl", "ply", "glb", "off", "dae")
MAX_BYTES_PER_FACE = 500  # 200,000 faces in the wordiest of the formats take half of this
NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
CUT_OFF = 0.02  # of an OBJ's vertices; more without a face, and no end to the last line: it was cut off
Z_UP = {  # turns that axis up into z up
    "x": np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
    "y": np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
}

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # what it logs of damaged files is not printed

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


def read_triangles(path: Path, *, max_faces: int = MAX_FACES) -> trimesh.Trimesh:
    """Read all triangles of a mesh file as one unprocessed mesh, z up, in file units; possibly empty or not finite.

    No other file is opened (no materials, textures or external buffers) and XML entities are refused. Metadata: `notes`,
    what was assumed; `unit`, metres per unit where the file says it.

    Raises:
        MeshError: missing, empty, of an unknown format, too large, truncated or not a mesh.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise MeshError(f"{path}: unknown mesh format {path.suffix!r}; expected one of {', '.join(FORMATS)}")
    try:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            raise MeshError(f"{path}: the mesh file {what}; expected a file of format {', '.join(FORMATS)}")
        size = path.stat().st_size
        if size == 0:
            raise MeshError(f"{path.name}: the mesh file is empty (0 bytes); export it again")
        limit = MAX_BYTES_PER_FACE * max_faces
        if size > limit:
            raise MeshError(
                f"{path.name}: the mesh file has {size / 1e6:.0f} MB; expected at most {limit / 1e6:.0f} MB "
                f"({max_faces:,} faces); decimate the mesh first"
            )
        data = path.read_bytes()
    except MemoryError as error:
        raise _no_memory(path.name, size) from error
    except OSError as error:
        raise MeshError(
            f"{path.name[:80]}: the mesh file cannot be read ({error.strerror}); check its name and its permissions"
        ) from error
    return parse_triangles(data, kind, path.name, max_faces=max_faces)


def _no_memory(name: str, size: int) -> MeshError:
    return MeshError(
        f"{name}: the memory does not suffice to read its {size / 1e6:.0f} MB; decimate the mesh, or write it as "
        "binary STL, which is read with least"
    )


def parse_triangles(
    data: bytes, kind: str, name: str, *, keep_order: bool = False, turn: bool = True, max_faces: int = MAX_FACES
) -> trimesh.Trimesh:
    """Parse the bytes of a mesh file; see `read_triangles`.

    Args:
        data: the file's bytes.
        kind: one of `FORMATS`.
        name: the file's name, for messages.
        keep_order: whether vertices must keep the file's order, also where faces name normals or textures.
        turn: whether a file with y up is turned so that z is up.
        max_faces: the limit.

    Raises:
        MeshError: too large, truncated or not a mesh.
    """
    try:
        found = announced(data, kind, name, max_faces=max_faces)
        mesh = _parsed(found.data, kind, name, keep_order=keep_order)
    except MemoryError as error:
        raise _no_memory(name, len(data)) from error
    if kind in ("off", "ply") and found.faces is not None and len(mesh.faces) < found.faces:
        raise damaged(name, kind, f"{found.faces} faces announced, {len(mesh.faces)} read")
    if np.ndim(mesh.vertices) != 2 or mesh.vertices.shape[1] != 3:
        raise damaged(name, kind, "its vertices are not points of three coordinates")
    if len(mesh.vertices) == 0:
        raise damaged(name, kind, "no triangles in it; a point cloud must be meshed first")
    notes = []
    if kind == "obj" and not data.endswith(b"\n") and not mesh.is_watertight:
        # An obj does not say how long it is: its last line and the vertices without a face tell.
        count = found.data.count(b"\nv ") + found.data.startswith(b"v ")
        unused = count - len(np.unique(mesh.faces))
        if unused > CUT_OFF * count:
            raise damaged(name, kind, f"the last line is not ended and {unused} vertices belong to no face")
        if unused > 0:
            notes.append(f"{unused} vertices belong to no face and the last line is not ended: is the file complete?")
    if found.up in Z_UP and turn:
        mesh.apply_transform(Z_UP[found.up])
        notes.append(f"{'glTF has' if kind == 'glb' else 'the file says'} {found.up} up: turned so that z is up")
    if not found.up and turn:
        notes.append("the file does not say which axis is up: read as z")
    mesh.metadata.clear()
    mesh.metadata.update(notes=notes, unit=found.unit)
    return mesh


def _fault(data: bytes, kind: str) -> str:
    """Return what is wrong with a file that a parser refuses, as far as its text tells; parsers speak of their arrays."""
    if kind == "off":
        count = re.match(rb"OFF\s+(?:#[^\n]*\s+)*(\d{1,18})", data[:4096])
        lines = [line for line in data.splitlines()[2:] if line.split() and not line.startswith(b"#")]
        if count and len(lines) < int(count[1]):
            return f"{int(count[1])} vertices announced, lines for {len(lines)}"
    if kind == "obj":
        for line in data.splitlines():
            words = line.split(b"#")[0].split()
            if words[:1] == [b"v"] and not all(NUMBER.fullmatch(word) for word in words[1:]):
                return f"the line '{line.decode('ascii', 'replace').strip()[:60]}' holds what is no number"
    return f"its content is not that of {'an' if kind in ('obj', 'off') else 'a'} {kind} file"


def _parsed(data: bytes, kind: str, name: str, *, keep_order: bool) -> trimesh.Trimesh:
    options = {"skip_materials": True} if kind in ("obj", "glb") else {}
    options |= {"maintain_order": True} if keep_order else {}
    errors: tuple[type[Exception], ...] = PARSE_ERRORS
    if kind == "dae":
        from collada.common import DaeError  # type: ignore[import-untyped]

        errors = (*PARSE_ERRORS, DaeError)
    try:
        with np.errstate(all="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, **options)
            mesh = scene.to_mesh()
    except errors as error:
        raise damaged(name, kind, _fault(data, kind)) from error
    if any(isinstance(each, trimesh.PointCloud) for each in scene.geometry.values()) and not len(mesh.vertices):
        raise MeshError(f"{name}: no triangles in it; expected a triangle mesh; a point cloud must be meshed first")
    if not isinstance(mesh, trimesh.Trimesh):
        raise damaged(name, kind, "no triangles in it; a point cloud must be meshed first")
    return mesh
