"""Scenes on disk: what is written comes back, and nothing hostile is followed."""

import json

import numpy as np
import pytest
import trimesh

from dexnudge.errors import OutputError, SceneError
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.families import SCENE_FAMILIES, build_scene
from dexnudge.scenes.scene import Scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene("clutter", builtin_object("remote-004"), seed=3, mass=0.2)


@pytest.fixture
def folder(scene, tmp_path):
    scene.save(tmp_path)
    return tmp_path


@pytest.mark.parametrize("family", SCENE_FAMILIES)
def test_a_scene_comes_back_as_it_was(family, tmp_path):
    scene = build_scene(family, builtin_object("phone-001"), seed=5, friction_hand=0.7)
    scene.save(tmp_path / "new" / "folder")
    back = Scene.load(tmp_path / "new" / "folder")
    np.testing.assert_array_equal(back.T_world_object, scene.T_world_object)
    np.testing.assert_allclose(back.motion, scene.motion, atol=1e-15)
    for mesh, original in (
        (back.object_mesh, scene.object_mesh),
        (back.environment_mesh, scene.environment_mesh),
    ):
        np.testing.assert_array_equal(mesh.faces, original.faces)
        np.testing.assert_allclose(mesh.vertices, original.vertices, atol=5.1e-10)
    assert back.parameters == json.loads(json.dumps(scene.parameters))
    for key in ("name", "seed", "mass", "friction_hand", "friction_environment", "max_normal_force", "motion_length"):
        assert getattr(back, key) == getattr(scene, key)


def test_the_file_holds_what_the_contract_names(folder):
    content = json.loads((folder / "scene.json").read_text())
    assert content["object_mesh"] == "object.obj"
    assert content["environment_mesh"] == "environment.obj"
    assert np.shape(content["T_world_object"]) == (4, 4)
    assert (content["scene"], content["seed"], content["mass"]) == ("clutter", 3, 0.2)
    assert "numpy" in content["versions"]
    for name in ("object", "environment"):
        assert trimesh.load_mesh(folder / f"{name}.obj", process=False).is_watertight


def rewritten(folder, **changes):
    content = json.loads((folder / "scene.json").read_text())
    content.update(changes)
    (folder / "scene.json").write_text(json.dumps(content))
    with pytest.raises(SceneError) as caught:
        Scene.load(folder)
    return str(caught.value)


@pytest.mark.parametrize("path", ["/etc/hostname.obj", "../object.obj", "a/../../object.obj", "..\\object.obj"])
def test_a_path_out_of_the_folder_is_refused(folder, path):
    assert rewritten(folder, object_mesh=path) == (
        f"object_mesh is {path!r}, outside the folder of scene.json; expected a relative path inside it; "
        "copy the mesh into the folder"
    )


def test_a_link_out_of_the_folder_is_refused(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "other.obj"
    outside.write_bytes((folder / "object.obj").read_bytes())
    (folder / "linked.obj").symlink_to(outside)
    assert "outside the folder of scene.json" in rewritten(folder, object_mesh="linked.obj")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"object_mesh": 3}, "object_mesh is 3; expected a path relative to the folder of scene.json"),
        ({"motion": [0, 0, 0]}, "motion is (0, 0, 0); expected a finite direction that is not zero, such as (1, 0, 0)"),
        ({"T_world_object": [[1, 0], [0, 1]]}, "T_world_object has shape (2, 2); expected (4, 4)"),
        ({"mass": 10**400}, "{path}: mass is above 1e+06; expected a number of an object and a scene"),
        ({"mass": -1}, "`mass` is -1.0; expected a finite number > 0"),
    ],
)
def test_wrong_values(folder, changes, expected):
    assert rewritten(folder, **changes) == expected.replace("{path}", str(folder / "scene.json"))


def test_wrong_kinds_of_values(folder):
    path = folder / "scene.json"
    assert rewritten(folder, mass="heavy") == f"{path}: mass is 'heavy'; expected a number"
    assert rewritten(folder, mass=0.1, seed=True) == f"{path}: seed is True; expected an integer or null"
    assert (
        rewritten(folder, seed=1, parameters=[]) == f"{path}: parameters is []; expected an object of names and values"
    )


def test_a_missing_key_and_files_that_are_no_scene(folder):
    path = folder / "scene.json"
    content = json.loads(path.read_text())
    del content["motion"]
    whole = json.dumps(content)

    def message_of(text: str) -> str:
        path.write_text(text)
        with pytest.raises(SceneError) as caught:
            Scene.load(folder)
        return str(caught.value)

    assert message_of(whole) == (
        f"{path}: the key 'motion' is missing; expected object_mesh, environment_mesh, T_world_object, motion, "
        "motion_length, mass, friction_hand, friction_environment, max_normal_force"
    )
    assert message_of(whole[:50]).startswith(f"{path}: cannot be read as JSON (")
    assert message_of("[]") == f"{path}: holds a JSON list; expected an object with named values"
    assert message_of('{"mass": NaN}') == (
        f"{path}: cannot be read as JSON (NaN is not a JSON number); the file is truncated or damaged"
    )
    path.unlink()
    with pytest.raises(SceneError) as caught:
        Scene.load(folder)
    assert str(caught.value) == f"{path}: no such file; expected a JSON file"


def test_a_scene_that_was_saved_on_windows_is_read_and_other_encodings_are_named(folder):
    path = folder / "scene.json"
    text = path.read_text()
    path.write_text(text, encoding="utf-8-sig")
    assert Scene.load(folder).mass == json.loads(text)["mass"]
    path.write_text(text, encoding="utf-16")
    with pytest.raises(SceneError) as caught:
        Scene.load(folder)
    assert str(caught.value) == f"{path}: cannot be read as JSON (it is not UTF-8); save it as UTF-8"


def test_a_folder_that_cannot_be_written(scene, tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OutputError, match="the scene cannot be written"):
        scene.save(tmp_path / "taken")
