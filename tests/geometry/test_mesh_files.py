"""Reading mesh files: intact, damaged, hostile."""

import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.errors import MeshError
from dexnudge.geometry.mesh_files import FORMATS, MAX_FACES, read_triangles

DAMAGED = "; the file is truncated, damaged or not a mesh; export it again"


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, 0.05)


def message_of(path: Path) -> str:
    with pytest.raises(MeshError) as caught:
        read_triangles(path)
    return str(caught.value)


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_the_triangles_that_were_written(kind, ball, tmp_path):
    ball.export(tmp_path / f"ball.{kind}")
    mesh = read_triangles(tmp_path / f"ball.{kind}")
    np.testing.assert_allclose(np.sort(mesh.area_faces), np.sort(ball.area_faces), rtol=1e-4)
    np.testing.assert_allclose(mesh.bounds, ball.bounds, atol=1e-7)


@pytest.mark.parametrize("kind", FORMATS)
def test_a_truncated_file_is_refused(kind, ball, tmp_path):
    path = tmp_path / f"ball.{kind}"
    ball.export(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    assert DAMAGED in message_of(path)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("content", [b"this is no mesh\n" * 9, bytes(range(256)) * 4, b"\0" * 500])
def test_a_file_that_is_no_mesh_is_refused(kind, content, tmp_path):
    path = tmp_path / f"noise.{kind}"
    path.write_bytes(content)
    assert DAMAGED in message_of(path)


def test_truncated_text_variants_are_refused(ball, tmp_path):
    stl, ply = tmp_path / "ascii.stl", tmp_path / "ascii.ply"
    text = ball.export(file_type="stl_ascii")
    stl.write_text(text[: len(text) // 2])
    data = ball.export(file_type="ply", encoding="ascii")
    ply.write_bytes(data[: len(data) * 2 // 3])
    assert DAMAGED in message_of(stl)
    assert DAMAGED in message_of(ply)


def test_error_texts(tmp_path):
    (tmp_path / "empty.obj").touch()
    (tmp_path / "cut.stl").write_bytes(b"\0" * 80 + struct.pack("<I", 5) + b"\0" * 120)
    (tmp_path / "folder.obj").mkdir()
    (tmp_path / "entity.dae").write_text('<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>')
    formats = "obj, stl, ply, glb, off, dae"
    missing = tmp_path / "missing.obj"
    assert message_of(missing) == f"{missing}: the mesh file does not exist; expected a file of format {formats}"
    folder = tmp_path / "folder.obj"
    assert message_of(folder) == f"{folder}: the mesh file is a folder; expected a file of format {formats}"
    other = tmp_path / "part.step"
    assert message_of(other) == f"{other}: unknown mesh format '.step'; expected one of {formats}"
    assert message_of(tmp_path / "empty.obj") == "empty.obj: the mesh file is empty (0 bytes); export it again"
    assert message_of(tmp_path / "cut.stl") == (
        "cut.stl: cannot be read as stl (5 faces announced, room for 2); "
        "the file is truncated, damaged or not a mesh; export it again"
    )
    assert message_of(tmp_path / "entity.dae") == (
        "entity.dae: the file declares XML entities (DOCTYPE); expected plain COLLADA; remove them"
    )


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "off"])
def test_a_million_faces_are_refused_before_they_are_parsed(kind, tmp_path):
    count = 1_000_000
    content = {
        "obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * count,
        "stl": b"\0" * 80 + struct.pack("<I", count) + b"\0" * (50 * count),
        "ply": b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 1000000\n" + b"3 0 1 2\n" * count,
        "off": b"OFF\n3 1000000 0\n" + b"3 0 1 2\n" * count,
    }
    path = tmp_path / f"huge.{kind}"
    path.write_bytes(content[kind])
    start = time.perf_counter()
    assert message_of(path) == (
        f"huge.{kind}: the mesh has 1,000,000 faces; expected at most {MAX_FACES:,}, so that exact distances stay fast; "
        "decimate it first (in MeshLab: Simplification: Quadric Edge Collapse Decimation)"
    )
    assert time.perf_counter() - start < 2.0


def test_an_obj_reads_no_other_file(tmp_path, monkeypatch):
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd secret.png\n")
    path = tmp_path / "box.obj"
    path.write_text("mtllib secret.mtl\nmtllib /etc/passwd\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    opened = []
    read_bytes = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda self: opened.append(self.name) or read_bytes(self))
    monkeypatch.setattr("builtins.open", lambda name, *_args, **_kwargs: pytest.fail(f"opened {name}"))
    mesh = read_triangles(path)
    assert len(mesh.faces) == 1
    assert opened == ["box.obj"]


def test_a_glb_with_an_external_buffer_is_refused(tmp_path):
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "../outside.bin", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    (tmp_path / "outside.bin").write_bytes(np.eye(3, dtype=np.float32).tobytes())
    (tmp_path / "in").mkdir()
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A)
    path = tmp_path / "in" / "part.glb"
    path.write_bytes(header + text)
    assert DAMAGED in message_of(path)
