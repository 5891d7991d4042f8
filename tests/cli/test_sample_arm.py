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


def test_an_object_out_of_reach_is_said_before_anything_is_drawn(dexnudge, tmp_path):
    options = ["--arm", "panda", "--arm-base", "-4", "0", "0", *QUICK, "--out", tmp_path / "out"]
    made = dexnudge("sample", "phone", "--scene", "table", *options)
    assert made.code == 2
    assert "the object is out of reach" in made.err
    assert "move --arm-base nearer" in made.err
    assert not (tmp_path / "out").exists()
