"""Whatever is wrong with the input: exit 2, one message that says what, and nothing left behind."""

import json
import os
import re

import numpy as np
import pytest
import trimesh

FORMATS = "obj, stl, ply, glb, off, dae"


@pytest.fixture
def refused(dexnudge, tmp_path):
    """Assert that the arguments are refused with a message, and that `out` was not made."""

    def check(*arguments: object, message: str) -> None:
        before = sorted(os.listdir(tmp_path))
        outcome = dexnudge(*arguments, "--out", tmp_path / "out")
        assert outcome.code == 2, outcome.out + outcome.err
        assert outcome.out == ""
        assert outcome.err.startswith("dexnudge: ")
        assert outcome.err.count("\n") == 1, "one message on one line"
        assert re.search(message, outcome.err), outcome.err
        assert sorted(os.listdir(tmp_path)) == before

    return check


def phone() -> trimesh.Trimesh:
    return trimesh.creation.box((0.15, 0.07, 0.008))


def mesh_file(folder, content: str | bytes, name: str = "object.obj"):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def obj(mesh: trimesh.Trimesh) -> str:
    return mesh.export(file_type="obj")


MESHES = {
    "empty": ("object.obj", "", "is empty"),
    "comment only": ("object.obj", "# nothing here\n", "cannot be read as obj"),
    "truncated": ("object.stl", phone().export(file_type="stl")[:300], "truncated|damaged|not a mesh|cannot be read"),
    "no mesh": ("object.ply", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "cannot be read|not a mesh|no .*mesh|damaged"),
    "NaN": (
        "object.obj",
        obj(phone()).replace("v ", "v nan ", 1).replace("nan -", "nan 0 -", 1),
        "finite|NaN|nan|number",
    ),
    "zero area": ("object.obj", "v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n", "area"),
    "sheet": ("object.obj", "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n", "sheet|volume|thick|flat"),
    "millimetres": ("object.obj", obj(phone().apply_scale(1000)), "is 150 m; expected 0.02 to 0.6 m; .*--units mm"),
    "too small": ("object.obj", obj(phone().apply_scale(0.01)), "0.0015 m; .* in another unit[?] Pass --length"),
    "format": ("object.xyz", "1 2 3", FORMATS),
}


@pytest.mark.parametrize("case", MESHES)
def test_meshes_that_cannot_be_used(refused, tmp_path, case):
    name, content, message = MESHES[case]
    refused("sample", mesh_file(tmp_path, content, name), "--scene", "table", message=message)


def test_a_million_faces_are_refused_before_they_are_worked_on(refused, tmp_path):
    side = 708
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(side * side)]) * 1e-4
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    lower = np.column_stack([corner, corner + 1, corner + side])
    faces = np.concatenate([lower, np.column_stack([corner + 1, corner + side + 1, corner + side])])
    path = tmp_path / "object.stl"
    path.write_bytes(trimesh.Trimesh(vertices, faces[:1_000_000], process=False).export(file_type="stl"))
    refused("sample", path, "--scene", "table", message=r"200,000")


def test_a_missing_mesh(refused, tmp_path):
    refused("sample", tmp_path / "phone.obj", "--scene", "table", message="does not exist")


def test_unknown_names_list_the_valid_ones(refused):
    refused("sample", "phone", "--scene", "table", "--hand", "shado", message="shadow_full, shadow_lite")
    refused("evaluate", "--objects", "builtin:tset", message="builtin:t|train, test|test, train")
    refused("evaluate", "--objects", "builtin:test", "--scenes", "tabel", message="expected some of table")
    refused("evaluate", "--objects", "builtin:test", "--method", "our", message="unknown method 'our'; expected one of")


def test_an_object_that_does_not_fit_its_scene(refused, tmp_path):
    tall = mesh_file(tmp_path, obj(trimesh.creation.box((0.5, 0.5, 0.5))))
    refused("sample", tall, "--scene", "shelf", message="fit")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "none of --scene, --environment and --depth given"),
        (["--scene", "table", "--environment", "e.obj"], "--scene and --environment given together"),
        (["--scene", "table", "--motion", "1", "0", "0"], "--motion given with --scene"),
        (["--environment", "e.obj"], "--environment needs --object-pose and --motion too"),
        (["--scene", "table", "--num", "0"], "--num is 0; expected at least 1"),
        (["--scene", "table", "--verified", "0"], "--verified is 0; expected at least 1"),
        (["--scene", "table", "--max-draws", "5"], "--max-draws limits the search for --verified draws"),
        (["--scene", "table", "--seed", "-1"], "--seed is -1; expected at least 0"),
        (["--scene", "table", "--seed", 2**64], f"--seed is {2**64}; expected at most {2**63 - 1}"),
        (["--scene", "table", "--num", 10**9], f"--num is {10**9}; expected at most 10000, the draws of one call"),
        (
            ["--scene", "table", "--verified", 2**31],
            f"--verified is {2**31}; expected at most 10000, all of which are kept",
        ),
        (
            ["--scene", "table", "--verified", 2, "--max-draws", 2**31],
            f"--max-draws is {2**31}; expected at most 320000",
        ),
        (["--scene", "table", "--weight-object", "1e300"], "expected a number from 0 to 1e+06"),
        (["--scene", "table", "--mass", "-1"], "--mass is -1"),
        (["--scene", "table", "--friction-hand", "nan"], "--friction-hand is nan"),
        (["--scene", "table", "--length", "70"], "--length is 70 m"),
        (["--scene", "table", "--units", "mm"], "--units is mm, but 'phone' is built in and has a size"),
        (["--scene", "table", "--num", "-" + "9" * 400], "--num is an integer of 400 digits; expected at least 1\n"),
    ],
)
def test_options_that_contradict_or_make_no_sense(refused, options, message):
    refused("sample", "phone", *options, message=re.escape(message))


@pytest.mark.parametrize(
    ("command", "option", "message"),
    [
        (
            ["hand", "shadow_lite", "--learn"],
            ["--minutes", -1],
            "--minutes is -1.0; expected more than 0, at most 1e+07",
        ),
        (["execute", "none"], ["--weights", "w"], "--weights is given without --then-grasp; expected both"),
        (["execute", "none"], ["--attempts", 2], "--attempts is given without --then-grasp; expected both"),
        (["plan", "none"], ["--weights", "w"], "--weights is given without --then-grasp; expected both"),
        (["evaluate", "--objects", "builtin:test"], ["--execute-num", 2], "--execute-num is given without --execute"),
        (["evaluate", "--objects", "builtin:test"], ["--data", "d"], "--data is given without the method nearest_pose"),
        (["evaluate", "--objects", "builtin:test"], ["--seed", -1], "--seed is -1; expected at least 0"),
        (["evaluate", "--objects", "builtin:test"], ["--seed", 2**64], f"expected at most {2**63 - 1}"),
        (["evaluate", "--objects", "builtin:test"], ["--num", 10**9], "expected at most 10000"),
        (["train", "--data", "nothing"], ["--seed", 2**64], f"expected a whole number from 0 to {2**63 - 1}"),
        (["evaluate", "--objects", "builtin:test"], ["--units", "cm"], "--units is cm, but 'builtin:test' is built in"),
        (["evaluate", "--objects", "builtin:test"], ["--workers", 0], "--workers is 0; expected at least 1"),
        (["evaluate", "--objects", "builtin:test"], ["--num", 0], "--num is 0; expected at least 1"),
        (["dataset", "generate", "--objects", "builtin:test"], ["--seed", -1], "--seed is -1; expected at least 0"),
        (["dataset", "generate", "--objects", "builtin:test"], ["--grasps", -1], "--grasps is -1; expected at least 0"),
        (["dataset", "generate", "--objects", "nothing"], [], "nothing: no such set of objects"),
        (["train", "--data", "nothing"], ["--seed", -1], "--seed is -1; expected a whole number from 0"),
        (["train", "--data", "nothing"], [], "expected a dataset folder"),
    ],
)
def test_the_other_commands_name_the_option(refused, command, option, message):
    refused(*command, *option, message=re.escape(message))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["dataset", "info", "none", "--objects", "o"],
            "--objects is given without --out; expected both; add --out, or",
        ),
        (["dataset", "info", "none", "--seed", 1], "--seed is given without --out; expected both"),
        (["dataset", "check", "none", "--objects", "o", "--seed", 1], "--seed is given without --num; expected both"),
        (["hand", "shadow_lite", "--minutes", 5], "--minutes is given without --learn; expected both"),
        (["hand", "shadow_lite", "--overwrite"], "--overwrite is given without --prepare; expected both"),
        (["hand", "shadow_lite", "--palm", "x"], "--palm is 'x', but shadow_lite is a hand with a name"),
        (["hand", "shadow_lite", "--package", "a=b"], "--package is {'a': 'b'}, but shadow_lite is a hand with a name"),
    ],
)
def test_options_that_do_nothing_without_another_are_refused(dexnudge, words, message):
    outcome = dexnudge(*words)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.startswith(f"dexnudge: {message}")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["phone", "--out", "x" * 300], "--out"),
        (["phone", f"--out={'x' * 300}"], "--out"),
        (["phone", "--hand", "a\0b"], "--hand"),
        (["x" * 300, "--scene", "table"], "an argument"),
    ],
)
def test_a_word_that_is_no_path_is_told_with_its_option(dexnudge, words, named):
    outcome = dexnudge("sample", *words)
    assert outcome.code == 2
    assert outcome.err.startswith(f"dexnudge: `{named}` is '")


def test_places_that_cannot_be_written(dexnudge, tmp_path):
    (tmp_path / "file").write_text("kept")
    out = ["--out", tmp_path / "file" / "out"]
    for command in (["dataset", "generate", "--objects", "builtin:test"], ["evaluate", "--objects", "builtin:test"]):
        outcome = dexnudge(*command, *out)
        assert outcome.code == 2
        assert "cannot write" in outcome.err
    assert os.listdir(tmp_path) == ["file"]


@pytest.fixture
def own_scene(tmp_path):
    """Options of a box that rests on a slab; each can be replaced."""
    mesh = mesh_file(tmp_path, obj(phone()))
    slab = trimesh.creation.box((1.0, 1.0, 0.1)).apply_translation((0, 0, -0.05))
    environment = mesh_file(tmp_path, obj(slab), "environment.obj")

    def options(*, height=0.004, motion=(1, 0, 0), pose=None):
        T_world_object = np.eye(4)
        T_world_object[2, 3] = height
        content = {"T_world_object": T_world_object.tolist()} if pose is None else pose
        (tmp_path / "pose.json").write_text(content if isinstance(content, str) else json.dumps(content))
        return [
            "sample",
            mesh,
            "--environment",
            environment,
            "--object-pose",
            tmp_path / "pose.json",
            "--motion",
            *motion,
        ]

    return options


def test_an_environment_that_penetrates_the_object(refused, own_scene):
    refused(*own_scene(height=-0.004), message=r"already penetrates the object by \d+\.\d mm")


def test_a_zero_motion(refused, own_scene):
    refused(*own_scene(motion=(0, 0, 0)), message=r"motion is \(0, 0, 0\)")


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "expected an object"),
        ({"T_world_object": np.diag([2.0, 2, 2, 1]).tolist()}, "not a rigid transform"),
        ({"T_world_object": [[1, 2], [3, 4]]}, r"expected \(4, 4\)"),
        ({"pose": 1}, "T_world_object"),
    ],
)
def test_poses_that_are_none(refused, own_scene, pose, message):
    refused(*own_scene(pose=pose), message=message)


URDF = """<robot name="r"><link name="palm"><collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>
<link name="tip"/><joint name="j" type="revolute"><parent link="palm"/><child link="{child}"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""
HAND_YAML = "palm: palm\nfingertips: {tip: tip}\npalm_normal: [0, 0, 1]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>', "entit|DOCTYPE"),
        (URDF.format(mesh="/etc/passwd", child="tip"), "outside|relative|absolute"),
        (URDF.format(mesh="../secret.obj", child="tip"), "outside"),
        (URDF.format(mesh="missing.obj", child="tip"), "missing.obj"),
        (URDF.format(mesh="ok.obj", child="palm"), "loop|itself|root"),
        ("<robot", "not well-formed"),
        ("", "not well-formed|empty"),
    ],
)
def test_hands_that_cannot_be_used(dexnudge, refused, tmp_path, text, message):
    folder = tmp_path / "hand"
    folder.mkdir()
    (folder / "ok.obj").write_text(obj(trimesh.creation.box((0.02, 0.02, 0.02))))
    (tmp_path / "secret.obj").write_text("v 0 0 0\n")
    (folder / "hand.yaml").write_text(HAND_YAML)
    (folder / "hand.urdf").write_text(text)
    refused("sample", "phone", "--scene", "table", "--hand", folder / "hand.urdf", message=message)
    outcome = dexnudge("hand", folder / "hand.urdf")
    assert outcome.code == 2
    assert re.search(message, outcome.err)


@pytest.mark.parametrize("command", [["sample", "phone", "--scene", "table"], ["hand", "shadow_lite"]])
def test_an_output_folder_that_exists_or_cannot_be_written(dexnudge, tmp_path, command):
    option = "--prepare" if command[0] == "hand" else "--out"
    (tmp_path / "out").mkdir()
    (tmp_path / "file").write_text("kept")
    for out, message in [
        ("out", "exists; expected a new one"),
        ("file", "is not a folder"),
        ("file/out", "cannot write"),
    ]:
        outcome = dexnudge(*command, option, tmp_path / out)
        assert outcome.code == 2
        assert message in outcome.err
    assert sorted(os.listdir(tmp_path)) == ["file", "out"]
    assert (tmp_path / "file").read_text() == "kept"


def test_check_of_something_that_is_no_result(dexnudge, tmp_path):
    for folder, message in [(tmp_path / "none", "is not a folder"), (tmp_path, "configurations.npz is missing")]:
        outcome = dexnudge("check", folder)
        assert outcome.code == 2
        assert message in outcome.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("dataset", "check", "{}"),
        ("dataset", "turns", "{}"),
        ("execute", "{}"),
        ("plan", "{}", "--arm", "panda"),
        ("sample", "{}", "--scene", "table"),
        ("sample", "phone", "--scene", "{}"),
        ("scene", "{}"),
        ("dataset", "generate", "--objects", "{}", "--out", "out"),
        ("train", "--data", "data", "--out", "{}"),
    ],
    ids=" ".join,
)
def test_a_name_that_no_file_system_takes(dexnudge, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    outcome = dexnudge(*(each.format(300 * "9") for each in arguments))
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1
    assert "at most 255 bytes" in outcome.err or "data" in outcome.err
    assert list(tmp_path.iterdir()) == []
