"""Meshes from files: units, checks, and what is repaired."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from dexnudge.errors import MeshError
from dexnudge.geometry.meshes import centre_of_mass, load_environment, load_mesh, load_scaled_mesh


def written(mesh: trimesh.Trimesh, path: Path) -> Path:
    mesh.export(path)
    return path


def block(*size: float) -> trimesh.Trimesh:
    return trimesh.creation.box(size)


def message_of(path: Path, **options) -> str:
    with pytest.raises(MeshError) as caught:
        load_mesh(path, **options)
    return str(caught.value)


@pytest.mark.parametrize(("units", "factor"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)])
def test_units_make_metres(units, factor, tmp_path):
    path = written(block(0.15 / factor, 0.07 / factor, 0.01 / factor), tmp_path / "box.ply")
    mesh = load_mesh(path, units=units)
    np.testing.assert_allclose(mesh.extents, [0.15, 0.07, 0.01], rtol=1e-6)
    assert mesh.volume == pytest.approx(0.15 * 0.07 * 0.01, rel=1e-5)
    assert mesh.metadata["scale"] == pytest.approx(factor)


def test_length_sets_the_longest_side_whatever_the_unit(tmp_path):
    path = written(block(3, 7, 150), tmp_path / "box.ply")
    np.testing.assert_allclose(load_mesh(path, units="in", length=0.2).extents, [0.004, 0.2 * 7 / 150, 0.2], rtol=1e-6)


def test_a_scale_in_metres_per_unit(tmp_path):
    path = written(block(1.6, 0.8, 0.2), tmp_path / "box.obj")
    np.testing.assert_allclose(load_scaled_mesh(path, 0.08).extents, [0.128, 0.064, 0.016], rtol=1e-6)


def test_the_wrong_unit_is_named(tmp_path):
    path = written(block(150, 70, 8), tmp_path / "phone.obj")
    assert message_of(path) == (
        "phone.obj: the longest side of the object is 150 m; expected 0.02 to 0.6 m; is the file in another unit? "
        "Pass `units` mm (0.15 m) or `length` METRES (sets the longest side)"
    )
    assert message_of(written(block(0.012, 0.01, 0.001), tmp_path / "tiny.obj")) == (
        "tiny.obj: the longest side of the object is 0.012 m; expected 0.02 to 0.6 m; is the file in another unit? "
        "Pass `length` METRES (sets the longest side)"
    )
    assert message_of(path, units="ft") == "unknown unit 'ft'; expected one of m, cm, mm, in"
    expected = "expected the longest side of the object in metres, between 0.02 and 0.6"
    assert message_of(path, length=15.0) == f"`length` is 15 m; {expected}"
    assert message_of(path, length=float("nan")) == f"`length` is nan m; {expected}"


def test_unusable_meshes_are_named(tmp_path):
    corners = "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 {}\n"
    two_triangles = "f 1 2 3\nf 1 3 4\n"
    not_finite = "1 of 4 vertices are NaN or infinite; expected finite numbers; export the mesh again"
    no_area = "the surface has no area; expected triangles that span a surface"
    no_thickness = "the object is a flat sheet; expected a body with a thickness; give it one"
    cases = {
        "nan": (corners.format("nan") + two_triangles, not_finite),
        "inf": (corners.format("inf") + two_triangles, not_finite),
        "line": ("v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n", no_area),
        "sheet": (corners.format("0") + two_triangles, no_thickness),
    }
    for name, (text, expected) in cases.items():
        path = tmp_path / f"{name}.obj"
        path.write_text(text)
        assert message_of(path) == f"{name}.obj: {expected}"


def test_a_point_cloud_is_refused(tmp_path):
    path = tmp_path / "cloud.ply"
    path.write_bytes(trimesh.PointCloud(np.eye(3)).export(file_type="ply"))
    assert message_of(path) == (
        "cloud.ply: no triangles in it; expected a triangle mesh; a point cloud must be meshed first"
    )


def test_an_inside_out_mesh_is_turned_and_noted(tmp_path):
    box = block(0.15, 0.07, 0.01)
    box.invert()
    mesh = load_mesh(written(box, tmp_path / "box.stl"))
    assert mesh.volume == pytest.approx(0.15 * 0.07 * 0.01, rel=1e-5)
    assert mesh.metadata["notes"] == ["the mesh was inside out and was turned round"]
    assert mesh.metadata["watertight"]


def test_single_faces_turned_round_are_turned_back(tmp_path):
    ball = trimesh.creation.icosphere(2, 0.05)
    faces = ball.faces.copy()
    faces[::7] = faces[::7, ::-1]
    mesh = load_mesh(written(trimesh.Trimesh(ball.vertices, faces, process=False), tmp_path / "ball.off"))
    assert mesh.volume == pytest.approx(ball.volume, rel=1e-6)
    assert mesh.metadata["notes"] == [
        f"{len(faces[::7])} faces were wound against their neighbours and were turned round"
    ]


def test_a_mesh_with_a_hole_is_accepted_and_noted(tmp_path):
    ball = trimesh.creation.icosphere(2, 0.05)
    ball.update_faces(np.arange(len(ball.faces)) > 20)
    mesh = load_mesh(written(ball, tmp_path / "bowl.ply"))
    assert mesh.metadata["watertight"] is False
    assert len(mesh.faces) == len(ball.faces)


def test_closed_bodies_that_touch_stay_closed(tmp_path):
    second = block(0.1, 0.1, 0.1)
    second.apply_translation([0.1, 0.1, 0])  # they share an edge
    both = trimesh.util.concatenate([block(0.1, 0.1, 0.1), second])
    mesh = load_mesh(written(both, tmp_path / "both.obj"))
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.002, rel=1e-6)


def test_an_environment_may_be_open_and_large_but_not_in_millimetres(tmp_path):
    sheet = tmp_path / "table.obj"
    sheet.write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3\nf 1 3 4\n")
    mesh = load_environment(sheet)
    np.testing.assert_allclose(mesh.extents, [2, 2, 0])
    assert mesh.metadata["watertight"] is False
    with pytest.raises(MeshError) as caught:
        load_environment(written(block(1200, 800, 40), tmp_path / "slab.stl"))
    assert str(caught.value) == (
        "slab.stl: the longest side of the environment is 1200 m; expected at most 50 m; "
        "is the file in another unit? Pass `units` cm (12 m) or `units` mm (1.2 m) or `units` in (30.5 m)"
    )


@given(st.tuples(*[st.floats(0.02, 0.3)] * 3), st.tuples(*[st.floats(-1, 1)] * 3))
def test_the_centre_of_mass_of_a_closed_body_is_that_of_its_volume(size, offset):
    cone = trimesh.creation.cone(size[0], size[1], sections=16)
    cone.apply_translation(offset)
    expected = np.add(offset, [0, 0, size[1] / 4])  # a cone's centre is a quarter of the way up
    np.testing.assert_allclose(centre_of_mass(cone), expected, atol=1e-6)


def test_the_centre_of_mass_of_an_open_body_is_that_of_its_hull():
    box = block(0.2, 0.1, 0.05)
    box.apply_translation([1, 2, 3])
    box.update_faces(np.arange(12) > 1)
    np.testing.assert_allclose(centre_of_mass(box), [1, 2, 3], atol=1e-9)
