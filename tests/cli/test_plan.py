"""`dexnudge plan`: what is written where nothing can be planned, and that an output that is taken is said at once."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import dexnudge as dn


@pytest.fixture(scope="module")
def far_base(sampled):
    """Where the Panda stands 1.1 m from the phone: near enough to try, too far for any configuration."""
    scene = dn.load_scene(sampled)
    T = dn.default_base(dn.load_arm("panda"), scene)
    centre = scene.object_in_world().bounds.mean(axis=0)
    way = (T[:3, 3] - centre) * (1.0, 1.0, 0.0)
    place = centre + 1.1 * way / np.linalg.norm(way)
    yaw = np.degrees(np.arctan2(T[1, 0], T[0, 0]))
    return [f"{value:.6f}" for value in (*place[:2], T[2, 3], 0.0, 0.0, yaw)]


def test_reasons_are_written_where_no_configuration_has_a_plan(dexnudge, sampled, far_base, tmp_path):
    command = ["plan", sampled, "--arm-base", *far_base, "--out", tmp_path / "plan", "--top", 2]
    found = dexnudge(*command)
    assert found.code == 3, found.err
    assert "no configuration has a plan" in found.out
    failures = json.loads((tmp_path / "plan/failures.json").read_text())["failures"]
    assert [one["configuration"] for one in failures] == [0, 1]
    assert {one["phase"] for one in failures} <= {"pre-contact", "contact", "push", "retreat"}
    assert all(one["reason"] for one in failures)
    assert dexnudge(*command).code == 2
    assert dexnudge(*command, "--overwrite").code == 3


def test_a_folder_that_is_taken_is_said_before_anything_is_planned(dexnudge, sampled, tmp_path, monkeypatch):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken/mine.txt").write_text("mine")

    def plan(*_, **__):
        raise AssertionError("planned for nothing")

    monkeypatch.setattr("dexnudge.trajectories.planner.plan", plan)
    monkeypatch.setattr("dexnudge.trajectories.base_map.find_base", plan)
    for command in (["plan"], ["find-base", "--arm", "panda"]):
        for options in ([], ["--overwrite"]):
            found = dexnudge(*command, sampled, "--out", tmp_path / "taken", *options)
            assert found.code == 2
            assert "--out" in found.err
    assert (tmp_path / "taken/mine.txt").read_text() == "mine"


def test_an_object_out_of_reach_is_said_before_planning(dexnudge, sampled, tmp_path):
    found = dexnudge("plan", sampled, "--arm-base", 5, 0, 0, "--out", tmp_path / "plan")
    assert found.code == 2
    assert "out of reach" in found.err
    assert not (tmp_path / "plan").exists()


@pytest.mark.parametrize("step", ["1e-9", "1e-300"])
def test_a_map_of_too_many_places_is_refused(dexnudge, sampled, tmp_path, step):
    found = dexnudge("find-base", sampled, "--arm", "panda", "--step", step, "--out", tmp_path / "base")
    assert found.code == 2
    assert "at most 20,000" in found.err


@pytest.mark.parametrize("command", ["plan", "find-base"])
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--arm", "no_such_arm"], "no_such_arm"),
        (["--arm", "panda", "--package", "x"], "--package got 'x'; expected NAME=DIR"),
        (["--arm", "panda", "--mount", "1"], "--mount got 1; expected a JSON file"),
    ],
)
def test_a_wrong_arm_is_said_before_the_samples_are_loaded(dexnudge, tmp_path, command, options, said):
    found = dexnudge(command, tmp_path, *options, "--out", tmp_path / "made")  # an empty folder
    assert found.code == 2
    assert said in found.err


def test_a_malformed_base_is_said_before_the_samples_are_loaded(dexnudge, tmp_path):
    found = dexnudge("plan", tmp_path, "--arm-base", "1", "2", "--out", tmp_path / "made")
    assert "--arm-base got 1 2; expected a JSON file" in found.err


def test_meshes_of_a_ros_package_are_found_where_it_is_said(dexnudge, tmp_path):
    """An arm whose meshes are named by package:// is read with --package, and refused without."""
    import trimesh

    (tmp_path / "elsewhere/meshes").mkdir(parents=True)
    trimesh.creation.box((0.05, 0.05, 0.2)).export(tmp_path / "elsewhere/meshes/link.stl")
    mesh = '<collision><geometry><mesh filename="package://stick/meshes/link.stl"/></geometry></collision>'
    links = "".join(f'<link name="l{i}">{mesh}</link>' for i in range(5))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0 0 0.2"/>'
        f'<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="2" effort="50"/></joint>'
        for i, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 0 1"))
    )
    end = '<link name="tool0"/><joint name="end" type="fixed"><parent link="l4"/><child link="tool0"/></joint>'
    (tmp_path / "stick.urdf").write_text(f'<robot name="stick">{links}{joints}{end}</robot>')
    (tmp_path / "stick.yaml").write_text("flange: tool0\nhome: [0, 0, 0, 0]\nlimits: {acceleration: 5, jerk: 50}\n")
    command = ["plan", tmp_path, "--arm", tmp_path / "stick.urdf", "--out", tmp_path / "made"]
    assert "package://stick" in dexnudge(*command).err
    found = dexnudge(*command, "--package", f"stick={tmp_path / 'elsewhere'}")
    assert "configurations.npz is missing" in found.err  # the arm is there, the samples are not


def test_an_arm_that_comes_below_its_plane_is_a_warning_before_all_else(dexnudge, sampled, tmp_path, monkeypatch):
    arm = SimpleNamespace(T_world_base=np.eye(4))
    found = SimpleNamespace(robot=SimpleNamespace(arm=arm), seconds={})
    monkeypatch.setattr("dexnudge.cli.plan.Plan._planned", lambda *_: found)
    monkeypatch.setattr("dexnudge.cli.plan._print", lambda *_, **__: print("the table"))
    monkeypatch.setattr("dexnudge.trajectories.plan_folder.write_plan", lambda *_, **__: None)
    monkeypatch.setattr("dexnudge.trajectories.plan.below_base", lambda _: 0.13)
    said = dexnudge("plan", sampled, "--arm", "panda", "--out", tmp_path / "out").out
    assert said.startswith("warning: the arm comes 13 cm below the plane that it stands on; --floor 0 keeps it above")
    assert "the table" in said
