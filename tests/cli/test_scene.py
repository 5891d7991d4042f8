"""`dexnudge scene`, and what `sample` does with its findings and its folders."""

import json
import os
import re
import shutil
import struct
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import dexnudge as dn
from dexnudge.perception.views import save_views
from dexnudge.simulation.depth_camera import DepthCamera, DepthRenderer, looking_at
from dexnudge.viewer.scene_view import scene_picture

QUICK = ["--method", "random_start_projection", "--num", "2", "--seed", "3"]


@pytest.fixture
def own(tmp_path):
    """Options of a flat box on a table, with what else stands there; each part can be replaced."""

    def options(*more, z=0.004, motion=(1, 0, 0), command="scene"):
        trimesh.creation.box((0.15, 0.07, 0.008)).export(tmp_path / "flat.stl")
        table = trimesh.creation.box(bounds=[[-0.6, -0.4, -0.04], [0.6, 0.4, 0.0]])
        trimesh.util.concatenate([table, *more]).export(tmp_path / "table.ply")
        pose = {"position": [0, 0, z], "quaternion_wxyz": [1, 0, 0, 0]}
        (tmp_path / "pose.json").write_text(json.dumps(pose))
        own = ["--environment", tmp_path / "table.ply", "--object-pose", tmp_path / "pose.json", "--motion", *motion]
        return [command, tmp_path / "flat.stl", *own, "--out", tmp_path / "out"]

    return options


def rib(height=0.006):
    return trimesh.creation.box(bounds=[[0.116, -0.2, -0.01], [0.126, 0.2, height]])


def test_names_that_are_not_utf_8_are_written(dexnudge, own, tmp_path):
    options = own()
    renamed = (tmp_path / "flat.stl").rename(tmp_path / "flat\udcff.stl")
    outcome = dexnudge(options[0], renamed, *options[2:])
    assert outcome.code == 0, outcome.err
    assert "flat_" in (tmp_path / "out" / "scene.html").read_text(encoding="utf-8")


def test_a_scene_folder_is_written_and_sampled(dexnudge, own, tmp_path):
    outcome = dexnudge(*own(), "--mass", "0.2")
    assert outcome.code == 0, outcome.err
    assert outcome.out.startswith("note: the object is 150 x 70 x 8 mm, 200 g\n")
    assert "note: the way along (1.00, 0.00, 0.00) is free for 100 mm\n" in outcome.out
    assert outcome.out.endswith(f"written: {tmp_path / 'out'}\n")
    assert sorted(os.listdir(tmp_path / "out")) == [
        "environment.obj",
        "findings.json",
        "object.obj",
        "scene.html",
        "scene.json",
        "scene.png",
    ]
    written = json.loads((tmp_path / "out" / "findings.json").read_text())["findings"]
    assert written == [each.as_dict() for each in dn.load_scene(tmp_path / "out").findings(dn.load_hand("shadow_lite"))]
    size = struct.unpack(">II", (tmp_path / "out" / "scene.png").read_bytes()[16:24])
    assert size == signature(scene_picture).parameters["size"].default

    sampled = dexnudge("sample", tmp_path / "out", *QUICK, "--motion-length", "0.05", "--out", tmp_path / "sampled")
    assert sampled.code in (0, 3), sampled.err
    scene = json.loads((tmp_path / "sampled" / "scene.json").read_text())
    assert (scene["mass"], scene["motion_length"], scene["scene"]) == (0.2, 0.05, "user")


def test_a_scene_with_an_error_is_written_for_looking_at_and_exits_2(dexnudge, own, tmp_path):
    outcome = dexnudge(*own(rib()))
    assert outcome.code == 2
    assert outcome.err.startswith(
        "dexnudge: the way along (1.00, 0.00, 0.00) is blocked after 41 mm by something 6 mm high at (0.116, "
    )
    assert "shorten --motion-length to 0.04, or choose another --motion: " in outcome.err
    assert "written: " in outcome.out
    found = json.loads((tmp_path / "out" / "findings.json").read_text())["findings"]
    assert [each["level"] for each in found].index("error") == 0
    assert "not seen" not in (tmp_path / "out" / "scene.html").read_text().split("<script")[0]
    again = dexnudge("sample", tmp_path / "out", *QUICK, "--out", tmp_path / "sampled")
    assert (again.code, "is blocked after 41 mm" in again.err) == (2, True)
    assert not (tmp_path / "sampled").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"z": -0.004}, "the environment already penetrates the object by 8.0 mm near "),
        ({"z": 0.5}, "the object touches nothing: the nearest surface is 496.0 mm below it"),
        ({"motion": (0, 0, -1)}, "the motion (0.00, 0.00, -1.00) leads 90 degrees into what carries the object"),
    ],
)
def test_sample_stops_before_drawing(dexnudge, own, tmp_path, changes, message):
    outcome = dexnudge(*own(command="sample", **changes), *QUICK)
    assert outcome.code == 2
    assert outcome.err.startswith(f"dexnudge: {message}")
    assert not (tmp_path / "out").exists()


def test_a_folder_has_its_own_scene(dexnudge, own, tmp_path):
    assert dexnudge(*own()).code == 0
    for option in (["--scene", "table"], ["--environment", "e.ply"], ["--motion", 1, 0, 0], ["--units", "mm"]):
        outcome = dexnudge("sample", tmp_path / "out", *option)
        assert outcome.code == 2
        assert outcome.err == (
            f"dexnudge: {option[0]} given with the scene of the folder {tmp_path / 'out'}, which has its own; make another "
            "scene, or leave it out\n"
        )


def test_names_are_escaped_on_the_page(dexnudge, tmp_path):
    trimesh.creation.box((0.15, 0.07, 0.008)).export(tmp_path / "<b>x.stl")
    outcome = dexnudge("scene", tmp_path / "<b>x.stl", "--scene", "table", "--out", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    page = (tmp_path / "out" / "scene.html").read_text()
    assert "&lt;b&gt;x, table" in page
    assert "<b>x" not in page


def test_family_scenes_take_a_clearance_and_a_length(dexnudge, tmp_path):
    options = ["--scene", "table", "--clearance", "0.003", "--motion-length", "0.05"]
    assert dexnudge("scene", "phone", *options, "--out", tmp_path / "out").code == 0
    scene = dn.load_scene(tmp_path / "out")
    assert (scene.clearance, scene.motion_length) == (0.003, 0.05)
    np.testing.assert_allclose(scene.T_world_object, dn.build_scene("table", "phone", seed=0).T_world_object, atol=1e-9)


@pytest.fixture(scope="module")
def depth_folder(tmp_path_factory):
    """Depth images with masks of a flat box on a table, from three places."""
    table = trimesh.creation.box(bounds=[[-0.3, -0.3, -0.04], [0.3, 0.3, 0.0]])
    pose = trimesh.transformations.translation_matrix((0, 0, 0.01))
    scene = dn.Scene(trimesh.creation.box((0.15, 0.07, 0.02)), table, pose, np.array([-1.0, 0.0, 0.0]))
    camera = DepthCamera(width=120, height=90, focal=110.0, noise=0.0, unit=0.0005)
    renderer, generator = DepthRenderer(scene, camera), np.random.default_rng(0)
    eyes = [(-0.35, 0.3, 0.4), (-0.4, -0.25, 0.4), (-0.5, 0.0, 0.3)]
    folder = tmp_path_factory.mktemp("depth") / "views"
    save_views([renderer.view(looking_at(np.zeros(3), np.array(eye)), generator) for eye in eyes], folder, unit=0.0005)
    return folder


def test_an_object_known_from_its_masks_alone(dexnudge, depth_folder, tmp_path):
    outcome = dexnudge("scene", "masked", "--depth", depth_folder, "--motion", -1, 0, 0, "--out", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    scene = dn.load_scene(tmp_path / "out")
    np.testing.assert_allclose(np.sort(scene.object_mesh.extents), [0.02, 0.07, 0.15], atol=0.016)  # 3 pixels
    assert re.search(r"note: of the surface around object and way \d+% was seen, \d+% is assumed, ", outcome.out)
    assert "</i>not seen<" in (tmp_path / "out" / "scene.html").read_text()


def test_depth_images_that_cannot_be_used_exit_2(dexnudge, depth_folder, tmp_path):
    broken = Path(shutil.copytree(depth_folder, tmp_path / "broken"))
    Image.fromarray(np.zeros((90, 120), dtype=np.uint8)).save(broken / "depth_0.png")
    for command in ("scene", "sample"):
        outcome = dexnudge(command, "masked", "--depth", broken, "--motion", -1, 0, 0, "--out", tmp_path / "out")
        assert (outcome.code, outcome.out) == (2, "")
        assert outcome.err.startswith(f"dexnudge: {broken / 'cameras.json'}: view 0")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["masked", "--depth", "d"], "--depth needs --motion too; add what is missing"),
        (["phone", "--depth", "d", "--motion", 1, 0, 0], "--depth needs --object-pose too; add what is missing"),
        (["phone"], "none of --scene, --environment and --depth given; expected one: "),
        (
            ["masked", "--depth", "d", "--motion", 1, 0, 0, "--length", 0.2],
            "--length is given for 'masked', which",
        ),
        (["masked", "--scene", "table"], "OBJECT is 'masked' without --depth; expected a mesh file, "),
        (["phone", "--scene", "table", "--masks", "m_{}.png"], "--masks given with --scene, which draws its own; use "),
        (
            ["phone", "--environment", "e.ply", "--object-pose", "p.json", "--motion", 1, 0, 0, "--unseen", "free"],
            "--unseen given with --environment, which has no views; use --depth, or leave it out",
        ),
        (
            ["phone", "--scene", "table", "--depth", "d"],
            "--scene and --depth given together; ",
        ),
    ],
)
def test_options_that_do_not_fit(dexnudge, options, message):
    outcome = dexnudge("sample", *options)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.startswith(f"dexnudge: {message}")


def test_a_folder_of_a_scene_does_not_tell_again_how_its_object_was_settled(dexnudge, own, tmp_path):
    assert "it was lowered onto it" in " ".join(dexnudge(*own(z=0.009)).out.split())
    said = dexnudge("sample", tmp_path / "out", *QUICK, "--out", tmp_path / "drawn").out
    assert "draws" in said
    assert "lowered" not in said
