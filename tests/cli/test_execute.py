"""`dexnudge execute` from a sampled folder to verdict, traces and a model that MuJoCo opens; and input it refuses."""

import json
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dexnudge.cli.execute import _print_pushes
from dexnudge.execution.folder import counts
from dexnudge.results.folder import read_configurations, write_configurations


@pytest.mark.slow
def test_the_best_configuration_pushes_a_phone_over_a_table(dexnudge, sampled, tmp_path):
    out = tmp_path / "execution"
    outcome = dexnudge("execute", sampled, "--films", 0, "--out", out)
    assert outcome.code == 0
    assert "1 of 1 pushes succeed" in outcome.out
    assert outcome.err == "executed 1 of 1: configuration 0: success\n"
    page = (out / "configuration_000/film.html").read_text(encoding="utf-8")
    assert "<h1>phone, table: configuration 0</h1>" in page  # whatever the folder is called
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
    assert "0 of 1 pushes succeed" in outcome.out
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


def pushed(number, outcome="fell_short", *, began_with=None, force=3.0, angle=0.0, detail=""):
    """The row of a push of 90 of 100 mm."""
    return {
        "configuration": number,
        "began_with": number if began_with is None else began_with,
        "success": outcome == "success",
        "outcome": outcome,
        "detail": detail,
        "angle_asked": angle,
        "angle_reached": 0.9 * angle,
        "length_asked": 0.09,
        "length_reached": 0.0897,
        "turned_deg": 3.0,
        "aside": 0.0234,
        "hand_environment": 0.0,
        "link_force": {"palm": force, "finger": 0.5},
        "limits": {"link_force": 5.0},
    }


def summary(*rows, verified=8):
    return {"verified": verified, "motion_length": 0.1} | counts(list(rows))


def test_how_far_an_object_went_aside_stands_beside_pushes_that_turn(capsys):
    _print_pushes(summary(pushed(0, "drifted", angle=1.0)), Path("row"))
    shown = capsys.readouterr().out
    assert "aside" in shown
    assert " 23.4 " in shown
    _print_pushes(summary(pushed(0, "drifted")), Path("row"))
    assert "aside" not in capsys.readouterr().out


def test_a_push_that_began_with_another_configuration_says_so_and_is_counted_once(capsys):
    rows = [pushed(4, "success", began_with=0), pushed(0, "success"), pushed(1), pushed(2, "success", began_with=9)]
    found = summary(*rows)
    assert {name: found[name] for name in ("attempted", "succeeded", "failed", "repeated")} == {
        "attempted": 4, "succeeded": 2, "failed": 1, "repeated": 1
    }  # fmt: skip
    assert found["success_rate"] == pytest.approx(2 / 3)
    assert [(row["configuration"], row["counted"]) for row in found["configurations"]] == [
        (0, True), (1, True), (2, True), (4, False)
    ]  # fmt: skip
    _print_pushes(found, Path("row"))
    shown = capsys.readouterr().out
    assert "│ 4 → 0 │ success" in shown
    assert "│ 2 → 9 │ success" in shown
    assert "not counted, as their push is counted already: 4 → 0\n" in shown
    assert "2 of 3 pushes succeed\n" in shown


def test_a_process_that_died_is_a_row_of_its_own(capsys):
    died = {"configuration": 1, "success": False, "outcome": "worker_died", "detail": "killed"}
    _print_pushes(summary(pushed(0), died), Path("row"))
    shown = capsys.readouterr().out
    assert "worker died: the process that simulated it died\n" in shown
    assert "configuration 1: killed\n" in shown
    assert "0 of 2 pushes succeed\n" in shown


def test_outcomes_are_named_in_the_table_and_explained_once_below_it(capsys):
    rows = [pushed(0, "pressed_too_hard", force=15.2), pushed(1, "pressed_too_hard", force=7.04), pushed(2, angle=1.0)]
    _print_pushes(summary(*rows), Path("row"))
    shown = capsys.readouterr().out
    lines = shown.splitlines()
    assert shown.count("a link pressed harder on the object than it may") == 1
    assert "≤ 5" in shown
    assert "15.2" in next(line for line in lines if "│ 0   │" in line)
    assert " 7.0" in next(line for line in lines if "│ 1   │" in line)
    assert max(map(len, lines[: lines.index(next(line for line in lines if line.startswith("└")))])) <= 80


def test_where_nothing_succeeds_what_else_there_is_to_play_is_said(capsys):
    _print_pushes(summary(pushed(0)), Path("row"))
    advice = "the best alone was played; 7 others are verified: `dexnudge execute row --top 4`\n"
    assert capsys.readouterr().out.endswith(advice)
    _print_pushes(summary(pushed(0), verified=1), Path("row"))
    assert "verified" not in capsys.readouterr().out
    _print_pushes(summary(pushed(0, "success")), Path("row"))
    assert "verified" not in capsys.readouterr().out


def test_a_push_that_is_shorter_than_the_motion_says_why(capsys):
    _print_pushes(summary(pushed(0, "success")), Path("row"))
    said = "pushed by 90 of the motion's 100 mm: there enough of the object hangs over the edge to be grasped\n"
    assert said in capsys.readouterr().out
    _print_pushes(summary(pushed(0, "success")) | {"motion_length": 0.09}, Path("row"))
    assert "of the motion's" not in capsys.readouterr().out


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
