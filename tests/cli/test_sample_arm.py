"""`dexnudge sample --arm`: reach among the criteria, from the command line to `check`."""

import json

import numpy as np

import dexnudge as dn

QUICK = ["--method", "random_start_projection", "--num", "2", "--seed", "3"]


def test_draws_are_judged_by_the_arm_and_checked_from_the_folder_alone(dexnudge, tmp_path):
    out = tmp_path / "out"
    made = dexnudge("sample", "phone", "--scene", "table", "--arm", "panda", *QUICK, "--out", out)
    assert made.code in (0, 3), made.err
    assert "reach: of Arm 'panda': 7 joints, flange 'panda_link8'" in made.out
    with np.load(out / "configurations.npz", allow_pickle=False) as arrays:
        assert arrays["reach"].shape == (2,)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["arm"] == "panda"
    assert "reach" in summary["criteria"]
    checked = dexnudge("check", out)
    assert checked.code == 0, checked.err
    assert "reach, largest" in checked.out
    assert dn.load_samples(out).verdicts.criteria[-1].arm.name == "panda"


def test_reach_as_a_term_needs_an_arm(dexnudge, tmp_path):
    options = ["--scene", "table", *QUICK, "--out", tmp_path / "out"]
    assert dexnudge("sample", "phone", "--term", "reach", *options).code == 2
    made = dexnudge("sample", "phone", "--term", "reach=2", "--arm", "panda", *options)
    assert made.code in (0, 3), made.err
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["terms"] == {"reach": 2.0}


def test_an_object_out_of_reach_is_said_before_anything_is_drawn(dexnudge, tmp_path):
    options = ["--arm", "panda", "--arm-base", "-4", "0", "0", *QUICK, "--out", tmp_path / "out"]
    made = dexnudge("sample", "phone", "--scene", "table", *options)
    assert made.code == 2
    assert "the object is out of reach" in made.err
    assert "move --arm-base nearer" in made.err
    assert not (tmp_path / "out").exists()


def test_where_an_arm_may_stand_is_mapped_and_taken_as_its_base(dexnudge, sampled, tmp_path):
    out = tmp_path / "base"
    made = dexnudge("find-base", sampled, "--arm", "panda", "--step", "0.3", "--extent", "0.6", "--out", out)
    assert made.code == 0, made.err
    assert "places are free; the best, (" in made.out
    assert f"--arm panda --arm-base {out / 'arm_base.json'}" in made.out
    again = ["--arm", "panda", "--arm-base", out / "arm_base.json", *QUICK, "--out", tmp_path / "out"]
    assert dexnudge("sample", "phone", "--scene", "table", *again).code in (0, 3)
