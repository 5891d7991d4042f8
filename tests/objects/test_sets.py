"""Sets of objects: folders, lists, built-in sets and the DexGraspNet layout."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.cli.scene_options import SceneOptions
from dexnudge.errors import InputError, MeshError, UnknownNameError
from dexnudge.objects.builtin import builtin_names
from dexnudge.objects.sets import resolve_object, resolve_object_set

SHARED = Path(__file__).parents[3] / "shared" / "objects" / "dexgraspnet"


@pytest.fixture
def meshdata(tmp_path):
    """Two objects in DexGraspNet's layout, in the unit ball."""
    for code, size in (("core-b", (1.6, 0.8, 0.2)), ("core-a", (1.8, 0.4, 0.3))):
        file = tmp_path / "meshdata" / code / "coacd" / "decomposed.obj"
        file.parent.mkdir(parents=True)
        trimesh.creation.box(size).export(file)
    return tmp_path / "meshdata"


def test_the_meshdata_layout_is_scaled_to_metres(meshdata):
    entries = resolve_object_set(str(meshdata))
    assert [entry.name for entry in entries] == ["core-a", "core-b"]
    np.testing.assert_allclose(entries[1].load().extents, [0.128, 0.064, 0.016], rtol=1e-6)


def test_a_mesh_of_that_layout_alone_is_called_by_its_code(meshdata):
    file = meshdata / "core-a" / "coacd" / "decomposed.obj"
    assert resolve_object(str(file), length=0.1).name == "core-a"
    scene = SceneOptions(object=str(file), scene="shelf")
    assert f"{scene.label}-{scene.place}" == "core-a-shelf"


@pytest.mark.parametrize(
    ("file", "name"),
    [("bad\udcff.stl", "bad_"), ("two\nlines.stl", "two_lines"), ("\x1b[31m.stl", "_[31m"), ("größe 1.stl", "größe 1")],
)
def test_names_of_files_are_printable(tmp_path, file, name):
    """Whatever bytes the file system has: Python reads those that are not UTF-8 as lone surrogates."""
    (tmp_path / file).write_bytes(trimesh.creation.box((0.15, 0.07, 0.008)).export(file_type="stl"))
    assert resolve_object(str(tmp_path / file)).name == name
    assert [entry.name for entry in resolve_object_set(str(tmp_path))] == [name]
    assert SceneOptions(object=str(tmp_path / file), scene="shelf").label == name
    assert SceneOptions(object="phone", environment=file).place == name


def test_default_folders_have_names_that_file_systems_take():
    long = SceneOptions(object=f"{'ä' * 120}.stl", environment=f"{'b' * 250}.stl")
    assert long.label == "ä" * 50
    assert long.place == "b" * 100


def test_a_length_overrides_the_scale(meshdata):
    assert [round(entry.load().extents.max(), 9) for entry in resolve_object_set(str(meshdata), length=0.15)] == [
        0.15
    ] * 2


def test_a_list_of_paths_is_relative_to_its_own_folder(meshdata):
    trimesh.creation.box((0.2, 0.1, 0.05)).export(meshdata.parent / "box.stl")
    listed = meshdata.parent / "some.txt"
    listed.write_text("# two of them\nmeshdata/core-b/coacd/decomposed.obj\n\nbox.stl\n")
    entries = resolve_object_set(str(listed))
    assert [entry.name for entry in entries] == ["core-b", "box"]
    np.testing.assert_allclose(entries[0].load().extents.max(), 0.128, rtol=1e-6)
    np.testing.assert_allclose(entries[1].load().extents.max(), 0.2, rtol=1e-6)


def test_a_folder_of_meshes_and_a_single_file(tmp_path):
    for name in ("b.stl", "a.obj", "a.ply"):
        trimesh.creation.box((200, 100, 50)).export(tmp_path / name)
    (tmp_path / "notes.txt").write_text("not a mesh")
    entries = resolve_object_set(str(tmp_path), units="mm")
    assert [entry.name for entry in entries] == ["a", "a-2", "b"]
    assert entries[2].load().extents.max() == pytest.approx(0.2)
    assert [entry.name for entry in resolve_object_set(str(tmp_path / "b.stl"))] == ["b"]


def test_built_in_sets():
    entries = resolve_object_set("builtin:test")
    assert [entry.name for entry in entries] == builtin_names("test")
    assert entries[0].load().is_watertight
    with pytest.raises(UnknownNameError, match="unknown built-in set 'tset'; expected builtin:train or builtin:test"):
        resolve_object_set("builtin:tset")


def test_some_of_a_built_in_set_are_evenly_spaced():
    names = builtin_names("train")
    assert [entry.name for entry in resolve_object_set("builtin:train:3")] == [names[0], names[106], names[213]]
    assert [entry.name for entry in resolve_object_set(f"builtin:train:{len(names)}")] == names
    for number in ("0", "321", "-1", "", "a", "1" * 5000):
        with pytest.raises(InputError, match=r"is no set of objects; expected a number from 1 to 320 after builtin:"):
            resolve_object_set(f"builtin:train:{number}")


def test_what_is_no_set_is_named(tmp_path):
    def message_of(path: Path) -> str:
        with pytest.raises(MeshError) as caught:
            resolve_object_set(str(path))
        return str(caught.value)

    (tmp_path / "empty").mkdir()
    (tmp_path / "blank.txt").write_text("\n# nothing\n")
    (tmp_path / "wrong.txt").write_text("gone.obj\n")
    assert message_of(tmp_path / "none") == (
        f"{tmp_path / 'none'}: no such set of objects; expected builtin:train, builtin:test, a folder of meshes, "
        "a DexGraspNet meshdata folder, or a text file of paths"
    )
    assert message_of(tmp_path / "empty") == (
        f"{tmp_path / 'empty'}: no meshes in this folder; expected files of format obj, stl, ply, glb, off, dae, "
        "or <code>/coacd/decomposed.obj"
    )
    assert message_of(tmp_path / "blank.txt") == (
        f"{tmp_path / 'blank.txt'}: the list is empty; expected one mesh path per line"
    )
    assert message_of(tmp_path / "wrong.txt") == (
        f"{tmp_path / 'wrong.txt'}: entry 1, {str(tmp_path / 'gone.obj')!r}, is not a mesh file; "
        "expected the path of an existing file of format obj, stl, ply, glb, off, dae"
    )


@pytest.mark.skipif(not SHARED.is_dir(), reason="the DexGraspNet meshes are not on this machine")
def test_every_real_mesh_loads_within_its_unit_ball():
    entries = resolve_object_set(str(SHARED / "meshdata"))
    assert len(entries) == 325
    for entry in entries[::5]:
        mesh = entry.load()
        assert np.linalg.norm(mesh.vertices, axis=1).max() <= 0.08 * 1.001
        assert mesh.volume > 0
