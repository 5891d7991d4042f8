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
    start = time.process_time()
    assert message_of(path) == (
        f"huge.{kind}: the mesh has 1,000,000 faces; expected at most {MAX_FACES:,}, so that exact distances stay fast; "
        "decimate it first (in MeshLab: Simplification: Quadric Edge Collapse Decimation)"
    )
    assert time.process_time() - start < 2.0


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


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_names_in_latin_1_are_no_reason_to_refuse(ball, tmp_path):
    text = ball.export(file_type="obj")
    path = written(tmp_path / "ball.obj", "mtllib Körper.mtl\no Körper\n".encode("latin-1") + text.encode())
    np.testing.assert_allclose(read_triangles(path).bounds, ball.bounds, atol=1e-7)
    data = ball.export(file_type="ply").replace(
        b"element vertex", "comment Körper\nelement vertex".encode("latin-1"), 1
    )
    np.testing.assert_allclose(read_triangles(written(tmp_path / "ball.ply", data)).bounds, ball.bounds, atol=1e-7)


def test_an_stl_is_read_as_far_as_it_announces(ball, tmp_path):
    data = ball.export(file_type="stl")
    assert len(read_triangles(written(tmp_path / "a.stl", data + b"COLOR=\xff\xe4 trailing")).faces) == len(ball.faces)
    capitals = ball.export(file_type="stl_ascii").upper().encode()
    assert len(read_triangles(written(tmp_path / "b.stl", capitals)).faces) == len(ball.faces)


def square_sides(order: str) -> bytes:
    """Return a binary PLY of six squares and, behind the last of them, what the header does not announce."""
    mark, name = ("<", "little") if order == "little" else (">", "big")
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    header = (
        f"ply\nformat binary_{name}_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 6\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = corners.astype(mark + "f4").tobytes() + b"".join(struct.pack(f"{mark}B4i", 4, *side) for side in sides)
    return header.encode() + body


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_binary_ply_is_read_as_far_as_it_announces(order, ball, tmp_path):
    squares = read_triangles(written(tmp_path / "squares.ply", square_sides(order) + b"\0 trailing"))
    assert squares.area == pytest.approx(6.0)
    if order == "little":
        data = ball.export(file_type="ply")
        mesh = read_triangles(written(tmp_path / "ball.ply", data + b"\xff" * 17))
        np.testing.assert_array_equal(mesh.faces, ball.faces)


def test_lists_of_fewer_than_no_corners_end_no_sooner_than_the_file(tmp_path):
    data = square_sides("little").replace(b"list uchar", b"list char").replace(b"face 6", b"face 100000")
    path = written(tmp_path / "back.ply", data[:-102] + struct.pack("<b", -1) * 102)
    assert DAMAGED in message_of(path)


@pytest.mark.parametrize(("kind", "encoding"), [("obj", "utf-16"), ("off", "utf-16"), ("stl_ascii", "utf-16-le")])
def test_text_in_utf_16_is_named(kind, encoding, ball, tmp_path):
    text = ball.export(file_type=kind)
    data = text.encode(encoding) if encoding == "utf-16" else b"\xff\xfe" + text.encode(encoding)
    assert "(it is in UTF-16; expected text in UTF-8)" in message_of(written(tmp_path / f"a.{kind[:3]}", data))


@pytest.mark.parametrize("kind", ["obj", "off", "stl_ascii", "ply"])
def test_lines_may_end_as_on_old_macs(kind, ball, tmp_path):
    data = ball.export(file_type=kind, **({"encoding": "ascii"} if kind == "ply" else {}))
    data = data.encode() if isinstance(data, str) else data
    mesh = read_triangles(written(tmp_path / f"a.{kind[:3]}", data.replace(b"\n", b"\r")))
    np.testing.assert_allclose(mesh.bounds, ball.bounds, atol=1e-7)


@pytest.mark.parametrize("begins", ["", "off\n", "# a ball\nOFF # of 642\n", "\nOFF "])
def test_an_off_may_leave_out_its_name(begins, ball, tmp_path):
    text = ball.export(file_type="off").removeprefix("OFF\n")
    mesh = read_triangles(written(tmp_path / "a.off", (begins + text).encode()))
    np.testing.assert_allclose(mesh.bounds, ball.bounds, atol=1e-7)


def test_an_obj_may_be_open_unended_and_hold_an_unused_vertex(ball, tmp_path):
    ball.update_faces(np.arange(len(ball.faces)) > 2)
    text = "v 0 0 0\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in ball.vertices)
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in ball.faces + 2)
    mesh = read_triangles(written(tmp_path / "loose.obj", text.rstrip("\n").encode()))
    assert len(mesh.faces) == len(ball.faces)
    assert mesh.metadata["notes"] == [
        "1 vertices belong to no face and the last line is not ended: is the file complete?"
    ]


def test_an_obj_counts_backwards_too(ball, tmp_path):
    count = len(ball.vertices)
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in ball.vertices.tolist())
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in ball.faces - count)
    mesh = read_triangles(written(tmp_path / "back.obj", text.encode()))
    np.testing.assert_array_equal(mesh.triangles, ball.triangles)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("v 0 1", "fewer than three numbers"),
        ("f 1 2", "fewer than three numbers"),
        ("f 0 1 2", "an index 0, though the first vertex has 1"),
        ("f 1/1/1 2/2/2 0/1/1", "an index 0, though the first vertex has 1"),
    ],
)
def test_a_line_of_an_obj_that_says_too_little_is_named(line, fault, tmp_path):
    path = written(tmp_path / "part.obj", f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{line}\n".encode())
    assert message_of(path) == f"part.obj: cannot be read as obj (the line '{line}' has {fault}){DAMAGED}"


def test_a_long_ply_header_hides_no_count(tmp_path):
    header = b"ply\nformat ascii 1.0\n" + b"comment long\n" * 500 + b"element vertex 3\nelement face 1000000\n"
    assert "the mesh has 1,000,000 faces" in message_of(written(tmp_path / "long.ply", header + b"3 0 1 2\n" * 9))


def glb(content: dict, binary: bytes = b"") -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


TRIANGLE = {
    "asset": {"version": "2.0"},
    "buffers": [{"byteLength": 36}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "nodes": [{"mesh": 0}],
    "scenes": [{"nodes": [0]}],
}


def test_a_gltf_has_y_up(tmp_path):
    mesh = read_triangles(written(tmp_path / "a.glb", glb(TRIANGLE, np.eye(3, dtype=np.float32).tobytes())))
    np.testing.assert_array_equal(mesh.triangles[0], [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert mesh.metadata["notes"] == ["glTF has y up: turned so that z is up"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "export it without Draco"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "export it without meshopt"),
        ({"accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3"}]}, "announces 1,000,000,000 values"),
        ({"nodes": [{"mesh": 0}] * 20_000, "scenes": [{"nodes": list(range(20_000))}]}, "20,000 copies"),
        ({"nodes": [{"children": [k + 1, k + 1]} for k in range(15)] + [{"mesh": 0}]}, "32,768 copies of meshes"),
        (
            {"nodes": [{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}]},
            "nodes; expected at most 200,000",
        ),
        ({"nodes": [{"children": [0]}]}, "below themselves"),
        ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 9, "type": "SCALAR"}]}, "three coordinates"),
    ],
)
def test_a_small_gltf_cannot_ask_for_much(changes, expected, tmp_path):
    path = written(tmp_path / "a.glb", glb(TRIANGLE | changes, np.eye(3, dtype=np.float32).tobytes()))
    start = time.process_time()
    assert expected in message_of(path)
    assert time.process_time() - start < 5.0


def collada(
    nodes: str, *, unit: str = "1", up: str = "Z_UP", corners: str = "0 0 0 1 0 0 0 1 0", library: str = ""
) -> str:
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="unit" meter="{unit}"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">{corners}</float_array><technique_common>
<accessor source="#pa" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
{library}<library_visual_scenes><visual_scene id="s"><node id="n">{nodes}</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


PLAIN = '<instance_geometry url="#g"/>'


def test_a_collada_says_which_way_is_up_and_what_its_unit_is(tmp_path):
    mesh = read_triangles(written(tmp_path / "a.dae", collada(PLAIN, unit="0.01", up="Y_UP").encode()))
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [1, 0, 1]], atol=1e-12)
    assert mesh.metadata == {"notes": ["the file says y up: turned so that z is up"], "unit": 0.01}


@pytest.mark.parametrize(
    ("up", "bounds", "notes"),
    [
        ("X_UP", [[-1, 0, 0], [0, 0, 1]], ["the file says x up: turned so that z is up"]),
        ("Z_UP", [[0, 0, 0], [1, 1, 0]], []),
        ("", [[0, 0, 0], [1, 1, 0]], ["the file does not say which axis is up: read as z"]),
    ],
)
def test_a_collada_may_have_any_axis_up(up, bounds, notes, tmp_path):
    mesh = read_triangles(written(tmp_path / "a.dae", collada(PLAIN, up=up).encode()))
    np.testing.assert_allclose(mesh.bounds, bounds, atol=1e-12)
    assert mesh.metadata["notes"] == notes
    path = written(tmp_path / "b.dae", collada(PLAIN, up="W_UP").encode())
    assert message_of(path) == "b.dae: its up axis is 'W_UP'; expected X_UP, Y_UP or Z_UP; mend <up_axis>"


def test_a_collada_may_hold_names_in_latin_1(tmp_path):
    text = collada(PLAIN).replace("<asset>", "<asset><contributor><author>Jörg</author></contributor>")
    assert len(read_triangles(written(tmp_path / "a.dae", text.encode("latin-1"))).faces) == 1


@pytest.mark.parametrize(
    ("doublings", "expected"),
    [(14, "16,384 copies of meshes; expected at most 10,000"), (24, "100,663,296 nodes; expected at most 200,000")],
)
def test_a_small_collada_cannot_ask_for_much(doublings, expected, tmp_path):
    nodes = '<node id="n0"><instance_geometry url="#g"/></node>' + "".join(
        f'<node id="n{k}"><instance_node url="#n{k - 1}"/><instance_node url="#n{k - 1}"/></node>'
        for k in range(1, doublings + 1)
    )
    text = collada(f'<instance_node url="#n{doublings}"/>', library=f"<library_nodes>{nodes}</library_nodes>")
    path = written(tmp_path / "bomb.dae", text.encode())
    start = time.process_time()
    assert message_of(path) == f"bomb.dae: the file places {expected}; join them"
    assert time.process_time() - start < 5.0


def test_what_a_collada_may_not_hold(tmp_path):
    path = written(tmp_path / "a.dae", collada(PLAIN, corners="0 0 0 1 0 0 0 1 nan").encode())
    assert message_of(path).endswith("a float_array holds NaN or infinity; expected numbers; export the mesh again")
    entity = '<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE a [<!ENTITY b "c">]><COLLADA>&b;</COLLADA>'
    assert "(it is in UTF-16; expected XML in UTF-8)" in message_of(written(path, entity.encode("utf-16")))
    assert "(it is in utf-7; expected XML in UTF-8)" in message_of(
        written(path, entity.replace("UTF-16", "UTF-7").encode("utf-7"))
    )
    assert "(it is compressed; expected XML in UTF-8)" in message_of(written(path, b"PK\x03\x04" + b"x" * 99))


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("far.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -99\n", "a face names vertex -99, but 3 stand before it"),
        ("e.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -1e300\n", "a face names vertex -1e300, but 3 stand before it"),
        (
            "short.stl",
            b"solid\nfacet\nvertex 0 0\nvertex 0 0 1 1\nvertex 0 1 0\nendfacet\n",
            "'vertex 0 0' has not three numbers",
        ),
    ],
)
def test_what_would_be_read_as_something_else_is_refused(name, content, fault, tmp_path):
    assert fault in message_of(written(tmp_path / name, content))
