"""`dexnudge plan`: what is written where nothing can be planned, and that an output that is taken is said at once."""

import json

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
    for options in ([], ["--overwrite"]):
        found = dexnudge("plan", sampled, "--out", tmp_path / "taken", *options)
        assert found.code == 2
        assert "--out" in found.err
    assert (tmp_path / "taken/mine.txt").read_text() == "mine"


def test_an_object_out_of_reach_is_said_before_planning(dexnudge, sampled, tmp_path):
    found = dexnudge("plan", sampled, "--arm-base", 5, 0, 0, "--out", tmp_path / "plan")
    assert found.code == 2
    assert "out of reach" in found.err
    assert not (tmp_path / "plan").exists()


def test_a_map_of_too_many_places_is_refused(dexnudge, sampled, tmp_path):
    found = dexnudge("find-base", sampled, "--arm", "panda", "--step", "1e-9", "--out", tmp_path / "base")
    assert found.code == 2
    assert "at most 20,000" in found.err
