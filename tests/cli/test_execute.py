"""`dexnudge execute` from a sampled folder to verdict, traces and a model that MuJoCo opens; and input it refuses."""

import json
import shutil

import mujoco
import numpy as np
import pytest

from dexnudge.cli.execute import _print_pushes
from dexnudge.results.folder import read_configurations, write_configurations


@pytest.mark.slow
def test_the_best_configuration_pushes_a_phone_over_a_table(dexnudge, sampled, tmp_path):
    out = tmp_path / "execution"
    outcome = dexnudge("execute", sampled, "--films", 0, "--out", out)
    assert outcome.code == 0
    assert "1 of 1 succeed" in outcome.out
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    (row,) = summary["configurations"]
    assert (summary["attempted"], summary["succeeded"], summary["failed"]) == (1, 1, 0)
    assert row["length_reached"] >= 0.8 * row["length_asked"] > 0.06
    assert row["turned_deg"] < 15
    assert row["hand_environment"] <= 0.002
    with np.load(out / "configuration_000/episode.npz", allow_pickle=False) as traces:
        scene = json.loads((sampled / "scene.json").read_text(encoding="utf-8"))
        moved = (traces["object_pose"][-1, :3] - traces["object_pose"][5, :3]) @ scene["motion"]
        assert moved == pytest.approx(row["length_reached"], abs=1e-3)
        assert traces["hand_object_force"][traces["phase"] == "push", 0].max() > 0
        qpos = traces["qpos"]
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    assert model.nkey > 5
    np.testing.assert_allclose(model.key_qpos[-1], qpos[-1], atol=1e-8)
    assert model.opt.timestep == 0.002
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    again = dexnudge("execute", sampled, "--out", out)
    assert again.code == 2
    assert "exists" in again.err


@pytest.mark.slow
def test_a_hand_too_slippery_exits_3_and_a_folder_that_is_left_out_is_numbered(dexnudge, sampled, tmp_path):
    folder = tmp_path / "slippery"
    shutil.copytree(sampled, folder)
    scene = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
    (folder / "scene.json").write_text(json.dumps({**scene, "friction_hand": 1e-3}), encoding="utf-8")
    (folder / "execution").mkdir()
    outcome = dexnudge("execute", folder, "--films", 0)
    assert outcome.code == 3, outcome.err
    assert "0 of 1 succeed" in outcome.out
    assert f"written: {folder / 'execution-2'}\n" in outcome.out
    summary = json.loads((folder / "execution-2" / "summary.json").read_text(encoding="utf-8"))
    assert (summary["attempted"], summary["succeeded"]) == (1, 0)


@pytest.mark.slow
def test_folders_that_cannot_be_executed_are_refused(dexnudge, sampled, tmp_path):
    none = tmp_path / "none verified"
    shutil.copytree(sampled, none)
    q, joint_names, verdicts = read_configurations(none)
    verdicts.success[:] = False
    write_configurations(none, q, joint_names, verdicts)
    outcome = dexnudge("execute", none)
    assert outcome.code == 2
    assert "none of the 8 configurations is verified; expected at least one" in outcome.err
    assert not (none / "execution").exists()


def test_how_far_an_object_went_aside_stands_beside_pushes_that_turn(capsys):
    row = {"configuration": 0, "outcome": "drifted", "detail": "23.4 mm", "angle_asked": 1.0, "angle_reached": 0.9}
    row |= {"length_asked": 0.0, "length_reached": 0.0, "turned_deg": 3.0, "aside": 0.0234, "hand_environment": 0.0}
    summary = {"configurations": [row], "succeeded": 0, "attempted": 1}
    _print_pushes(summary)
    shown = capsys.readouterr().out
    assert "aside" in shown
    assert " 23.4 " in shown
    _print_pushes(summary | {"configurations": [row | {"angle_asked": 0.0, "length_asked": 0.1}]})
    assert "aside" not in capsys.readouterr().out


def test_a_folder_that_is_not_there_is_refused(dexnudge, tmp_path):
    outcome = dexnudge("execute", tmp_path / "missing")
    assert outcome.code == 2
    assert outcome.err == (
        f"dexnudge: {tmp_path / 'missing'} is not a folder; expected the one that `dexnudge sample` or Samples.save wrote\n"
    )


def test_counts_below_one_are_refused(dexnudge, tmp_path):
    outcome = dexnudge("execute", tmp_path, "--top", "0")
    assert outcome.code == 2
    assert outcome.err == "dexnudge: --top is 0; expected at least 1\n"
