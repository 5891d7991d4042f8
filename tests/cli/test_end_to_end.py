"""The whole path on a tiny scale: generate, train, sample, check, evaluate, each from the files of the one before."""

import json
import os
from pathlib import Path

import pytest

from dexnudge.cli.main import main
from dexnudge.objects.builtin import builtin_names, builtin_object

pytestmark = pytest.mark.slow
TINY = ["--steps", "6", "--width", "32", "--depth", "1", "--groups", "2", "--rows-per-group", "4"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two objects, their dataset in data/, and the model trained on it in run/."""
    folder = tmp_path_factory.mktemp("end_to_end")
    objects, data, run = (str(folder / name) for name in ("objects", "data", "run"))
    (folder / "objects").mkdir()
    for name in builtin_names("train")[:2]:
        builtin_object(name).export(folder / "objects" / f"{name}.obj")
    attempts = ["--non-prehensile", "64", "--grasps", "8", "--workers", "1"]
    assert main(["dataset", "generate", "--objects", objects, "--out", data, *attempts]) == 0
    assert main(["train", "--data", data, "--out", run, *TINY]) == 0
    return folder


def test_from_objects_to_verified_configurations(dexnudge, folder):
    objects, data, run, out = (folder / name for name in ("objects", "data", "run", "out"))

    outcome = dexnudge("dataset", "info", data)
    assert outcome.out.startswith("hand shadow_lite: ")
    kept = int(outcome.out.split()[2])
    assert kept >= 10
    assert "2 objects (0 not generated yet, 0 failed)" in outcome.out
    outcome = dexnudge("dataset", "check", data, "--objects", objects, "--num", 5)
    assert outcome.out == f"{kept} configurations of 2 objects read, 5 verified again: all agree\n"

    assert sorted(os.listdir(run / "model")) == ["README.md", "config.json", "model.safetensors"]

    options = ["--scene", "table", "--weights", run / "model", "--num", 8]
    assert dexnudge("sample", "phone", *options, "--out", out).code == 0
    assert dexnudge("check", out).code == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["verified"] >= 1  # projection alone reaches this; the model has seen next to nothing

    options = ["--objects", objects, "--scenes", "table", "layers", "--weights", run / "model", "--num", 4]
    outcome = dexnudge("evaluate", *options, "--out", folder / "experiment", "--workers", 1)
    assert outcome.code == 0, outcome.err
    assert "| table | dexnudge | 2 | 0 | 8 |" in outcome.out
    assert "| layers | dexnudge | 2 | 0 | 8 |" in outcome.out
    again = dexnudge("evaluate", *options, "--out", folder / "experiment", "--workers", 1)
    assert again.out == outcome.out


def test_damaged_and_foreign_weights_are_refused(dexnudge, folder, tmp_path):
    model = folder / "run" / "model"
    weights = (model / "model.safetensors").read_bytes()
    config = json.loads((model / "config.json").read_text())
    sample = ["sample", "phone", "--scene", "table", "--out", tmp_path / "out", "--num", 2]
    damages = {
        "truncated": (weights[: len(weights) // 2], config, "model.safetensors"),
        "foreign": (weights, {**config, "model": {**config["model"], "joint_names": ["x"] * 16}}, "joint"),
    }
    for name, (content, changed, message) in damages.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.safetensors").write_bytes(content)
        (tmp_path / name / "config.json").write_text(json.dumps(changed))
        outcome = dexnudge(*sample, "--weights", tmp_path / name)
        assert outcome.code == 2
        assert message in outcome.err
    assert sorted(os.listdir(tmp_path)) == ["foreign", "truncated"]
    outcome = dexnudge(*sample, "--weights", model, "--hand", "shadow_full")
    assert outcome.code == 2
    assert "shadow_full" in outcome.err
