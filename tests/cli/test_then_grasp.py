"""`dexnudge execute --then-grasp`: a phone is pushed to the edge of a table, grasped and lifted; and input it refuses."""

import json

import mujoco
import numpy as np
import pytest


@pytest.mark.slow
def test_a_phone_is_slid_grasped_and_lifted_in_one_simulation(dexnudge, sampled, tmp_path):
    out = tmp_path / "lift"
    outcome = dexnudge("execute", sampled, "--then-grasp", "--films", "0", "--out", out)
    assert outcome.code == 0
    assert "success: yes" in outcome.out
    assert "slid by: number of the configuration that slides it" in outcome.out
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    last = summary["attempts"][-1]
    assert summary["success"]
    assert (last["phase"], last["outcome"]) == ("", "success")
    assert len(summary["attempts"]) <= 3
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    body = model.body("pushed object").id
    with np.load(out / summary["trace"], allow_pickle=False) as trace:
        time, phase, qpos = trace["time"], trace["phase"], trace["qpos"]
    scene = json.loads((sampled / "scene.json").read_text(encoding="utf-8"))
    places, touching = [], []
    for row in qpos:  # MuJoCo's own kinematics and contacts, from the trace alone
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        places.append(np.array(data.xipos[body]))
        sides = model.geom_contype[np.asarray(data.contact.geom).reshape(-1, 2)].sum(axis=1)
        touching.append(bool((sides == 2 + 4).any()))  # object and surroundings
    places, touching = np.array(places), np.array(touching)
    # Nothing was put anywhere: no record is farther from the one before than 2 m/s takes it.
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 2.0 * np.diff(time).max() + 1e-3
    np.testing.assert_allclose(np.diff(time), np.clip(np.diff(time), 0.001, 0.0201))
    slid = (places[np.flatnonzero(phase == "release")[0]] - places[0]) @ scene["motion"]
    assert slid > 0.05
    assert slid == pytest.approx(last["length_reached"], abs=0.01)
    assert last["length_reached"] == pytest.approx(last["length_asked"], abs=0.01)
    held = np.flatnonzero(phase == "hold")
    assert time[held[-1]] - time[held[0]] == pytest.approx(2.0, abs=0.05)
    assert (places[held, 2] - places[0, 2]).min() >= 0.08
    assert not touching[held].any()
    assert touching[0]
    assert last["raised"] == pytest.approx(places[held[0], 2] - places[0, 2], abs=0.003)
    again = dexnudge("execute", sampled, "--then-grasp", "--out", out)
    assert again.code == 2
    assert "exists" in again.err


@pytest.mark.slow
def test_a_hand_without_weights_is_refused_before_anything_is_simulated(dexnudge, sampled, tmp_path):
    outcome = dexnudge("execute", sampled, "--then-grasp", "--weights", tmp_path / "none")
    assert outcome.code == 2
    assert f"no weights for hand 'shadow_lite': expected a model folder, got {tmp_path / 'none'}" in outcome.err
    assert not (sampled / "slide_grasp_lift").exists()


def test_top_is_refused_with_then_grasp(dexnudge, tmp_path):
    outcome = dexnudge("execute", tmp_path, "--then-grasp", "--top", "2")
    assert outcome.code == 2
    assert outcome.err == (
        "dexnudge: --top is 2 with --then-grasp, which goes through the configurations by itself, best first; "
        "expected no --top; use --attempts\n"
    )


def test_attempts_below_one_are_refused(dexnudge, tmp_path):
    outcome = dexnudge("execute", tmp_path, "--then-grasp", "--attempts", "0")
    assert outcome.code == 2
    assert outcome.err == "dexnudge: --attempts is 0; expected at least 1\n"
