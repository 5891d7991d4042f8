"""Meshes as scanners and CAD programs write them end in the right mesh, and what was done is said."""

import numpy as np
import pytest
import trimesh

from dexnudge.errors import MeshError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.mesh_repair import drop_specks, turned_toward, without_small_holes
from dexnudge.geometry.meshes import load_environment, load_mesh

SIZE = (0.15, 0.07, 0.012)


def body(subdivisions: int = 2) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(SIZE)
    for _ in range(subdivisions):
        mesh = mesh.subdivide()
    return mesh


def reversed_faces(mesh: trimesh.Trimesh, which: slice) -> trimesh.Trimesh:
    faces = np.array(mesh.faces)
    faces[which] = faces[which][:, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def together(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


def read(mesh: trimesh.Trimesh, tmp_path, name: str = "part.ply", load=load_mesh) -> trimesh.Trimesh:
    mesh.export(tmp_path / name)
    found = load(tmp_path / name)
    # Normals are those of the winding, whatever was turned round.
    np.testing.assert_allclose(found.face_normals, trimesh.triangles.normals(found.triangles)[0], atol=1e-9)
    return found


def moved(mesh: trimesh.Trimesh, *offset: float) -> trimesh.Trimesh:
    return mesh.copy().apply_translation(offset)


def assert_depths_are_those_of_the_box(mesh: trimesh.Trimesh) -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, size=(200, 3)) * np.array(SIZE)
    depth = (np.array(SIZE) / 2 - np.abs(points)).min(axis=1)
    np.testing.assert_allclose(ExactDistance(mesh)(points).distance, -depth, atol=1e-6)


@pytest.mark.parametrize("shared", [True, False])
def test_a_two_sided_surface_counts_once(shared, tmp_path):
    box = body()
    faces = np.concatenate([box.faces, box.faces[:, ::-1] + (0 if shared else len(box.vertices))])
    vertices = box.vertices if shared else np.tile(box.vertices, (2, 1))
    mesh = read(trimesh.Trimesh(vertices, faces, process=False), tmp_path)
    assert mesh.metadata["notes"] == [f"{len(box.faces)} of {len(faces)} faces stood there twice and count once"]
    assert_depths_are_those_of_the_box(mesh)


def test_closed_bodies_with_a_common_face_keep_it(tmp_path):
    mesh = read(together(body(0), moved(body(0), SIZE[0], 0, 0)), tmp_path)
    assert mesh.metadata["notes"] == []
    assert mesh.volume == pytest.approx(2 * np.prod(SIZE), rel=1e-6)


def test_an_open_scan_is_wound_outward(tmp_path):
    mesh = reversed_faces(body(), slice(0, None, 5))
    mesh.update_faces(np.arange(len(mesh.faces)) > 2)
    found = read(mesh, tmp_path)
    assert found.is_winding_consistent
    assert "were wound against their neighbours" in found.metadata["notes"][0]
    centred = found.triangles_center - found.bounds.mean(axis=0)
    assert (np.einsum("ij,ij->i", centred, found.face_normals) > 0).all()


def test_most_faces_of_each_part_decide(tmp_path):
    found = read(reversed_faces(body(3), slice(0, 5)), tmp_path)
    assert found.metadata["notes"] == ["5 faces were wound against their neighbours and were turned round"]
    found = read(reversed_faces(body(3), slice(0, 1)), tmp_path)
    assert found.metadata["notes"] == ["1 face was wound against its neighbours and was turned round"]


def test_a_body_inside_out_is_turned_and_a_hollow_is_kept(tmp_path):
    knob = moved(trimesh.creation.box((0.01, 0.01, 0.004)), 0, 0, 0.009)
    knob.invert()
    found = read(together(body(), knob), tmp_path)
    assert found.volume == pytest.approx(np.prod(SIZE) + 0.01 * 0.01 * 0.004, rel=1e-5)
    assert found.metadata["notes"] == ["parts of 12 faces were inside out and were turned round"]
    hollow = trimesh.creation.box((0.1, 0.05, 0.006))
    hollow.invert()
    found = read(together(body(), hollow), tmp_path)
    assert found.volume == pytest.approx(np.prod(SIZE) - 0.1 * 0.05 * 0.006, rel=1e-5)
    assert found.metadata["notes"] == []


def test_specks_are_left_out_and_keys_are_kept(tmp_path):
    speck, key = trimesh.creation.icosphere(1, 0.0008), trimesh.creation.box((0.004, 0.004, 0.001))
    found = read(together(body(), moved(speck, 0.02, 0.01, -0.009), moved(key, 0, 0, 0.0066)), tmp_path)
    np.testing.assert_allclose(found.bounds, [[-0.075, -0.035, -0.006], [0.075, 0.035, 0.0071]], atol=1e-6)
    assert len(found.faces) == len(body().faces) + 12
    assert found.metadata["notes"] == [
        "1 small part that stands apart from the rest was left out (the largest 1.1 % of the object's length)"
    ]


def test_a_vertex_of_no_face_is_no_part():
    mesh = trimesh.Trimesh([[0, 0, 0.05], *body(0).vertices], body(0).faces + 1, process=False)
    far = moved(body(0), 1, 0, 0)
    mesh = trimesh.Trimesh([*mesh.vertices, *far.vertices], [*mesh.faces, *(far.faces + 9)], process=False)
    assert drop_specks(mesh) is None
    assert len(mesh.faces) == 24


def test_a_stray_part_is_named(tmp_path):
    together(body(0), moved(body(0), 1e12, 0, 0)).export(tmp_path / "stray.obj")
    for load in (load_mesh, load_environment):
        with pytest.raises(
            MeshError, match=r"^stray.obj: a part of the mesh lies at \(1e\+12, .*remove the stray one$"
        ):
            load(tmp_path / "stray.obj")


def test_a_table_of_one_layer_faces_up(tmp_path):
    sheet = trimesh.Trimesh([[-0.3, -0.3, 0], [-0.3, 0.3, 0], [0.3, 0.3, 0], [0.3, -0.3, 0]], [[0, 1, 2], [0, 2, 3]])
    found = read(sheet, tmp_path, load=load_environment)
    assert (found.face_normals[:, 2] > 0.99).all()
    assert found.metadata["notes"] == ["every face faced down: turned round, so that something can lie on it"]
    assert read(found, tmp_path, load=load_environment).metadata["notes"] == []


def sheet(low, high, *, height, up):
    (x, y), (u, v) = low, high
    corners = [[x, y, height], [u, y, height], [u, v, height], [x, v, height]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]] if up else [[2, 1, 0], [3, 2, 0]])


def test_a_room_seen_from_inside_stays_as_it_is(tmp_path):
    room = trimesh.creation.box((4.0, 3.0, 2.5))
    room = reversed_faces(room, slice(None))
    room.update_faces(room.face_normals[:, 2] > -0.5)  # no ceiling
    found = read(room, tmp_path, load=load_environment)
    assert found.metadata["notes"] == []
    assert (found.face_normals @ [0, 0, 1]).max() == pytest.approx(1)


@pytest.mark.parametrize("turned", [[], [0], [1], [0, 1]])
def test_open_sheets_are_turned_toward_the_object(turned):
    layers = [sheet((-1, -1), (1, 1), height=0.0, up=True), sheet((-1, -1), (0, 1), height=0.03, up=False)]
    for index in turned:
        layers[index].invert()
    found = turned_toward(together(*layers), np.array([-0.02, 0.0, 0.006]))
    np.testing.assert_allclose(found.face_normals[:, 2], [1, 1, -1, -1])
    assert found.metadata.get("notes", []) == (
        [f"open parts of {2 * len(turned)} faces had their back to the object and were turned round"] if turned else []
    )


def test_a_closed_body_is_not_turned_toward_the_object():
    slab = trimesh.creation.box((1.0, 1.0, 0.1))
    assert turned_toward(slab, np.array([0.0, 0.0, 0.02])) is slab


@pytest.mark.parametrize("missing", [[5], [5, 60, 140], [10, 11, 12]])
def test_small_holes_are_closed(missing):
    mesh = body(3)
    mesh.update_faces(~np.isin(np.arange(len(mesh.faces)), missing))
    closed = without_small_holes(mesh)
    assert not mesh.is_watertight
    assert closed.is_watertight
    assert closed.is_winding_consistent
    assert closed.volume == pytest.approx(np.prod(SIZE), rel=1e-3)


def test_a_missing_side_is_no_small_hole():
    mesh = body()
    mesh.update_faces(mesh.face_normals[:, 2] < 0.5)
    assert without_small_holes(mesh) is mesh
