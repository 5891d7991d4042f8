"""Scenes in the user's own surroundings."""

import json

import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError, SceneError
from dexnudge.hands.registry import load_hand
from dexnudge.objects.builtin import builtin_object
from dexnudge.objects.sets import resolve_object_set
from dexnudge.scenes.files import load_pose
from dexnudge.scenes.scene import Scene


@pytest.fixture
def slab(tmp_path):
    mesh = trimesh.creation.box((1000, 600, 40))
    mesh.apply_translation([0, 0, -20])
    mesh.export(tmp_path / "slab.stl")
    return tmp_path / "slab.stl"


def posed(tmp_path, content) -> str:
    path = tmp_path / "pose.json"
    path.write_text(json.dumps(content))
    return str(path)


def test_files_in_millimetres_and_a_pose_in_metres(slab, tmp_path):
    phone = builtin_object("phone")
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 0.2, 0.005]
    scene = Scene.from_files(
        phone,
        environment=slab,
        object_pose=posed(tmp_path, {"T_world_object": pose.tolist()}),
        motion=(0.0, 2.0, 0.0),
        units="mm",
        mass=0.3,
    )
    np.testing.assert_allclose(scene.environment_mesh.extents, [1.0, 0.6, 0.04], rtol=1e-6)
    np.testing.assert_array_equal(scene.T_world_object, pose)
    np.testing.assert_array_equal(scene.motion, [0, 1, 0])
    assert (scene.name, scene.mass, scene.seed) == ("user", 0.3, None)


def test_position_and_quaternion_are_the_matrix(tmp_path):
    half = np.radians(30) / 2
    pose = load_pose(posed(tmp_path, {"position": [1, 2, 3], "quaternion_wxyz": [np.cos(half), 0, 0, np.sin(half)]}))
    expected = trimesh.transformations.rotation_matrix(np.radians(30), [0, 0, 1])
    expected[:3, 3] = [1, 2, 3]
    np.testing.assert_allclose(pose, expected, atol=1e-12)


def test_malformed_poses_are_named(tmp_path):
    path = tmp_path / "pose.json"

    def message_of(content) -> str:
        with pytest.raises(SceneError) as caught:
            load_pose(posed(tmp_path, content))
        return str(caught.value)

    assert message_of({"pose": 1}) == (
        f"{path}: holds 'pose'; expected 'T_world_object' (4 x 4), or 'position' (x, y, z in metres) and 'quaternion_wxyz'"
    )
    assert message_of({"position": [0, 0, 0], "quaternion_wxyz": [0, 0, 0, 2]}) == (
        f"{path}: quaternion_wxyz has norm 2; expected 1, in the order w, x, y, z"
    )
    assert message_of({"position": [0, 0], "quaternion_wxyz": [1, 0, 0, 0]}) == (
        f"{path}: position is [0, 0]; expected 3 finite numbers"
    )
    assert message_of({"position": ["a", 0, 0], "quaternion_wxyz": [1, 0, 0, 0]}) == (
        f"{path}: position is ['a', 0, 0]; expected 3 numbers"
    )
    assert message_of({"position": [0, 0, 10**400], "quaternion_wxyz": [1, 0, 0, 0]}) == (
        f"{path}: position is [0, 0, 1{72 * '0'}; expected 3 numbers"
    )
    assert message_of({"T_world_object": [[1, 2]]}) == f"{path}: T_world_object has shape (1, 2); expected (4, 4)"


def test_surroundings_inside_the_object_are_refused(slab):
    pose = np.eye(4)
    pose[2, 3] = -0.002  # 7 mm deep: 5 mm are still settled
    with pytest.raises(SceneError, match=r"the environment already penetrates the object by \d\.\d mm near"):
        Scene.from_files(
            builtin_object("phone"), environment=slab, object_pose=pose, motion=(1.0, 0.0, 0.0), units="mm"
        )


def test_a_zero_motion_is_refused(slab):
    pose = np.eye(4)
    pose[2, 3] = 0.005
    with pytest.raises(SceneError, match="motion is"):
        Scene.from_files(
            builtin_object("phone"), environment=slab, object_pose=pose, motion=(0.0, 0.0, 0.0), units="mm"
        )


LONG = "a" * 300


@pytest.mark.parametrize(
    "use",
    [
        lambda: Scene.from_files(f"{LONG}.obj", environment=LONG, object_pose=LONG, motion=(1, 0, 0)),
        lambda: Scene.from_files("phone", environment=f"{LONG}.ply", object_pose=LONG, motion=(1, 0, 0)),
        lambda: Scene.load(LONG),
        lambda: load_pose(LONG),
        lambda: load_hand(f"{LONG}.urdf"),
        lambda: load_hand(LONG),
        lambda: resolve_object_set(LONG),
    ],
)
def test_a_name_that_is_too_long_for_a_file_is_no_bug(use):
    with pytest.raises(InputError):
        use()


@pytest.mark.parametrize(("factor", "unit"), [(1000, "millimetres"), (100, "centimetres"), (1 / 0.0254, "inches")])
def test_a_position_in_another_unit_is_asked_about(slab, factor, unit):
    pose = np.eye(4)
    pose[:3, 3] = np.array([0.1, 0.2, 0.005]) * factor
    with pytest.raises(SceneError, match=f"is the pose in {unit}\\?"):
        Scene.from_files("phone", environment=slab, object_pose=pose, motion=(1.0, 0.0, 0.0), units="mm")


def test_what_was_done_to_the_meshes_is_noted(tmp_path):
    sheet = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 2, 1], [0, 3, 2]], process=False)
    sheet.export(tmp_path / "sheet.ply")
    pose = np.eye(4)
    pose[2, 3] = 0.005
    scene = Scene.from_files("phone", environment=tmp_path / "sheet.ply", object_pose=pose, motion=(1.0, 0.0, 0.0))
    assert scene.notes == ["environment: every face faced down: turned round, so that something can lie on it"]


def test_a_pose_file_may_hold_the_bare_matrix_and_is_named_when_it_is_another(tmp_path):
    path = tmp_path / "pose.json"
    path.write_text(json.dumps(np.eye(4).tolist()))
    np.testing.assert_array_equal(load_pose(path), np.eye(4))
    path.write_text(json.dumps(np.eye(4)[:3].tolist()))
    with pytest.raises(SceneError) as caught:
        load_pose(path)
    assert str(caught.value) == (
        f"{path}: T_world_object has shape (3, 4); expected (4, 4); add the last row [0, 0, 0, 1]"
    )
