"""What an installed package brings is listed, used by name, and refused by name where it is broken."""

import json
import os

import numpy as np
import pytest
import trimesh

MODULE = """
import dexnudge as dn

class HighPalm:
    name = "high_palm"
    weight = 1.0

    def __call__(self, hands, scene):
        return (0.5 - hands.q[:, 2]).clamp_min(0.0) ** 2

class AboveFloor:
    name = "above_floor"

    def __call__(self, hands, scene):
        height = hands.points[..., 2].amin(dim=1)
        return dn.CriterionResult(value=height, passed=height > -1.0, sentence="lift the scene; draw more (`num`)")

class Never(AboveFloor):
    name = "never"

    def __call__(self, hands, scene):
        found = super().__call__(hands, scene)
        return dn.CriterionResult(value=found.value, passed=found.value > 1e3, sentence="it never holds; raise `mass`")
"""
ENTRY_POINTS = """
[dexnudge.energy_terms]
high_palm = house_plugin:HighPalm
lost = house_plugin_that_is_missing:Term

[dexnudge.criteria]
above_floor = house_plugin:AboveFloor
never = house_plugin:Never
"""


@pytest.fixture(autouse=True)
def package(tmp_path, monkeypatch):
    """An installed package `house-plugin` 1.2, as importlib.metadata finds it on the path."""
    site = tmp_path / "site"
    info = site / "house_plugin-1.2.dist-info"
    info.mkdir(parents=True)
    (site / "house_plugin.py").write_text(MODULE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: house-plugin\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(site))


def test_they_are_listed_and_a_broken_one_is_named(dexnudge):
    outcome = dexnudge("plugins")
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    assert lines[lines.index("hand:") + 1 :][:2] == ["  allegro", "  dex3"]
    assert "  above_floor, from house-plugin 1.2" in lines
    assert "  high_palm, from house-plugin 1.2" in lines
    (lost,) = (line for line in lines if line.startswith("  lost, from house-plugin 1.2; broken: "))
    assert "No module named 'house_plugin_that_is_missing'" in lost


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--term", "high_plam=2"], "unknown energy term 'high_plam' (did you mean 'high_palm'?); expected one of"),
        (["--term", "lost"], "energy term 'lost' of package house-plugin 1.2 cannot be imported"),
        (["--term", "high_palm=much"], "--term got 'high_palm=much'; expected NAME=WEIGHT with a number above 0"),
        (["--term", "high_palm=0"], "the weight of term 'high_palm' is 0.0; expected a finite number above 0"),
        (["--term", "high_palm", "--term", "high_palm=2"], "--term names 'high_palm' twice; expected each name once"),
        (["--criterion", "above_flor"], "unknown criterion 'above_flor' (did you mean 'above_floor'?); expected one"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name_and_nothing_is_written(dexnudge, tmp_path, options, message):
    outcome = dexnudge("sample", "phone", "--scene", "table", *options, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert outcome.err.startswith(f"dexnudge: {message}")
    assert outcome.err.count("\n") == 1
    assert os.listdir(tmp_path) == ["site"]


def test_terms_and_criteria_are_used_written_and_checked(dexnudge, tmp_path):
    out = tmp_path / "out"
    options = ["--term", "high_palm=0.5", "--criterion", "above_floor", "--criterion", "never"]
    quick = ["--method", "random_start_projection", "--num", 2]
    outcome = dexnudge("sample", "phone", "--scene", "table", *options, *quick, "--out", out)
    assert outcome.code == 3, outcome.err  # `never` is never met
    assert "raise --friction-hand or --max-normal-force" in outcome.out, "sentences of criteria name options"
    with np.load(out / "configurations.npz") as found:
        assert found["above_floor"].shape == found["never"].shape == (2,)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["terms"] == {"high_palm": 0.5}
    assert summary["verified"] == 0
    checked = dexnudge("check", out)
    assert checked.code == 0, checked.err
    assert "above_floor" in checked.out


@pytest.mark.slow
def test_an_experiment_judges_by_them_too(dexnudge, tmp_path):
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "box.obj")
    command = ["evaluate", "--objects", tmp_path / "box.obj", "--scenes", "table", "--out", tmp_path / "out"]
    quick = ["--method", "random_start_projection", "--num", 2, "--workers", 1]
    refused = dexnudge(*command, *quick, "--criterion", "nevr")
    assert refused.code == 2
    assert refused.err.startswith("dexnudge: unknown criterion 'nevr' (did you mean 'never'?)")
    assert not (tmp_path / "out").exists()
    outcome = dexnudge(*command, *quick, "--criterion", "never", "--term", "high_palm=0.5")
    assert outcome.code == 0, outcome.err
    (line,) = (tmp_path / "out" / "results.jsonl").read_text().splitlines()
    assert json.loads(line)["success"] == [False, False]
    config = json.loads((tmp_path / "out" / "experiment.json").read_text())["config"]
    assert (config["terms"], config["criteria"]) == ({"high_palm": 0.5}, ["never"])
