"""`dexnudge sample` and `check`, whole: the folder that other tools rely on, and what check finds when it lies."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
import yourdfpy

import dexnudge as dn

NUM = 8  # draws of the fixture `sampled`
# Needs no weights, and few draws take the least time.
QUICK = ["--method", "random_start_projection", "--num", "2", "--seed", "3"]


@pytest.fixture
def copy(sampled, tmp_path) -> Path:
    """A result folder that a test may damage."""
    return Path(shutil.copytree(sampled, tmp_path / "copy"))


def arrays(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / "configurations.npz", allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def test_the_folder_holds_exactly_what_is_promised(sampled):
    assert sorted(os.listdir(sampled)) == [
        "configurations.npz",
        "environment.obj",
        "hand",
        "object.obj",
        "scene.json",
        "summary.json",
        "view.html",
        "view.png",
    ]
    assert sorted(os.listdir(sampled.parent)) == ["phone"]
    scene = json.loads((sampled / "scene.json").read_text())
    assert np.shape(scene["T_world_object"]) == (4, 4)
    assert np.linalg.norm(scene["motion"]) == pytest.approx(1.0)
    assert (scene["scene"], scene["seed"]) == ("table", 0)


def test_every_draw_is_written_with_the_joints_of_the_hand(sampled):
    found = arrays(sampled)
    robot = yourdfpy.URDF.load(str(sampled / "hand" / "hand.urdf"), load_meshes=False, load_collision_meshes=True)
    assert found["q"].shape == (NUM, 9 + 16)
    assert found["joint_names"].tolist() == robot.actuated_joint_names
    links = {link for row in found["contact_links"] for link in row.split(",") if row}
    assert links
    assert links <= set(robot.link_map)


def test_the_summary_counts_every_draw(sampled):
    summary = json.loads((sampled / "summary.json").read_text())
    assert summary["drawn"] == NUM == summary["verified"] + sum(summary["rejected"].values())
    assert summary["verified"] == int(arrays(sampled)["success"].sum())
    assert summary["verified_rate"] == summary["verified"] / NUM
    assert {"load", "prepare", "draw", "project", "verify", "picture"} <= set(summary["seconds"])
    assert summary["peak_memory_mb"] > 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or torch.version.cuda is not None, reason="torch for GPUs takes more")
def test_a_phone_on_a_table_takes_little_more_than_libraries_do(tmp_path):
    command = [sys.executable, "-m", "dexnudge", "sample", "phone", "--scene", "table", "--out", str(tmp_path / "out")]
    subprocess.run(command, check=True, env={**os.environ, "OMP_NUM_THREADS": "2"})
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["drawn"], summary["peak_memory_mb"] < 614) == (32, True)  # measured: 586, without cache


def test_verified_ones_stand_first(sampled):
    success = arrays(sampled)["success"]
    assert success[0]
    assert (np.diff(success.astype(int)) <= 0).all()


def test_python_draws_what_the_command_drew(sampled):
    scene, hand = dn.load_scene(sampled), dn.load_hand(sampled / "hand" / "hand.urdf")
    again = dn.Sampler(dn.load_hand("shadow_lite")).sample(scene, hand=hand, num=NUM, seed=0)
    found = arrays(sampled)
    np.testing.assert_array_equal(again.q, found["q"])
    np.testing.assert_array_equal(again.success, found["success"])
    np.testing.assert_array_equal(
        again.verdicts.force_margin.astype(found["force_margin"].dtype), found["force_margin"]
    )


def test_check_agrees_with_an_untouched_folder_wherever_it_lies(dexnudge, copy):
    outcome = dexnudge("check", copy)
    assert outcome.code == 0, outcome.err
    assert outcome.out.endswith("every figure agrees\n")


def change(folder: Path, **changes) -> None:
    found = arrays(folder)
    for key, function in changes.items():
        found[key] = function(found[key].copy())
    np.savez(folder / "configurations.npz", **found)


def first(value):
    def set_first(array):
        array[0] = value
        return array

    return set_first


def test_check_finds_every_changed_figure(dexnudge, copy):
    change(
        copy,
        success=first(False),
        penetration_object=lambda depths: depths + 0.001,
        penetration_environment=first(np.nan),
        force_margin=first(0.123),
        contact_links=first("nolink"),
    )
    outcome = dexnudge("check", copy)
    assert outcome.code == 2
    assert "figures differ from what the files give" in outcome.err
    for message in (
        "configuration 0: success is",
        "configuration 0: penetration_object is",
        "configuration 7: penetration_object is",
        "configuration 0: penetration_environment is nan",
        "configuration 0: force_margin is 0.123 in the file",
        "configuration 0: contact_links are nolink in the file",
    ):
        assert message in outcome.err


def test_check_finds_a_moved_object(dexnudge, copy):
    scene = json.loads((copy / "scene.json").read_text())
    scene["T_world_object"][2][3] += 0.0005
    (copy / "scene.json").write_text(json.dumps(scene))
    assert dexnudge("check", copy).code == 2


def test_check_finds_a_summary_that_does_not_count(dexnudge, copy):
    summary = json.loads((copy / "summary.json").read_text())
    summary["verified"] += 1
    (copy / "summary.json").write_text(json.dumps(summary))
    outcome = dexnudge("check", copy)
    assert outcome.code == 2
    assert "summary.json: verified is" in outcome.err


@pytest.mark.parametrize(
    "name", ["scene.json", "object.obj", "environment.obj", "hand/hand.urdf", "configurations.npz", "summary.json"]
)
@pytest.mark.parametrize("damage", ["missing", "empty", "truncated"])
def test_missing_and_damaged_files_are_named(dexnudge, copy, name, damage):
    path = copy / name
    content = path.read_bytes()
    path.unlink()
    if damage != "missing":
        # A cut mesh can still be a mesh; then the figures differ.
        path.write_bytes(content[: len(content) // 2] if damage == "truncated" else b"")
    outcome = dexnudge("check", copy)
    assert outcome.code == 2
    assert path.name in outcome.err or "figures differ" in outcome.err


def test_a_hand_of_other_joints_is_refused(dexnudge, copy):
    change(copy, joint_names=lambda names: names[::-1])
    outcome = dexnudge("check", copy)
    assert outcome.code == 2
    assert "expected the same joints in the same order" in outcome.err


def test_a_scene_that_points_outside_its_folder_is_refused(dexnudge, copy):
    scene = json.loads((copy / "scene.json").read_text())
    scene["object_mesh"] = "../object.obj"
    (copy / "scene.json").write_text(json.dumps(scene))
    outcome = dexnudge("check", copy)
    assert outcome.code == 2
    assert "outside the folder" in outcome.err


@pytest.mark.slow
def test_verified_goes_on_drawing_up_to_a_limit(dexnudge, tmp_path):
    outcome = dexnudge(
        "sample", "phone", "--scene", "table", "--out", tmp_path / "out", *QUICK, "--verified", 1000, "--max-draws", 3
    )
    assert outcome.code in (0, 3)
    assert "of the 1000 verified draws asked for were reached in 3 draws" in " ".join(outcome.out.split())
    assert len(arrays(tmp_path / "out")["q"]) == 3
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["drawn"] == 3


@pytest.mark.slow
def test_own_surroundings_and_motion(dexnudge, tmp_path):
    trimesh.creation.box((0.15, 0.07, 0.008)).apply_scale(1000).export(tmp_path / "object.stl")
    slab = trimesh.creation.box((1.0, 1.0, 0.1)).apply_translation((0, 0, -0.05))
    slab.apply_scale(1000).export(tmp_path / "slab.ply")
    pose = {"position": [0.1, 0.2, 0.004], "quaternion_wxyz": [1, 0, 0, 0]}
    (tmp_path / "pose.json").write_text(json.dumps(pose))
    own = ["--environment", tmp_path / "slab.ply", "--object-pose", tmp_path / "pose.json", "--motion", 0, 2, 0]
    outcome = dexnudge(
        "sample", tmp_path / "object.stl", *own, "--units", "mm", "--mass", "0.3", "--out", tmp_path / "out", *QUICK
    )
    assert outcome.code in (0, 3), outcome.err
    scene = json.loads((tmp_path / "out" / "scene.json").read_text())
    assert (scene["scene"], scene["mass"], scene["motion"]) == ("user", 0.3, [0.0, 1.0, 0.0])
    assert dexnudge("check", tmp_path / "out").code == 0


@pytest.mark.slow
def test_a_disk_that_fills_while_writing_leaves_nothing(dexnudge, tmp_path, monkeypatch):
    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    outcome = dexnudge("sample", "phone", "--scene", "table", "--out", tmp_path / "out", *QUICK)
    assert outcome.code == 2
    assert "No space left on device" in outcome.err
    assert os.listdir(tmp_path) == []


def test_weights_that_are_missing_truncated_or_foreign(dexnudge, tmp_path):
    (tmp_path / "weights").mkdir()
    for folder, message in [("none", "does not exist"), ("weights", "config.json")]:
        outcome = dexnudge(
            "sample", "phone", "--scene", "table", "--weights", tmp_path / folder, "--out", tmp_path / "out"
        )
        assert outcome.code == 2
        assert message in outcome.err
    assert sorted(os.listdir(tmp_path)) == ["weights"]
