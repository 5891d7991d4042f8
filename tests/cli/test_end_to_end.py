"""The whole path on a tiny scale: generate, train, sample, check, evaluate, each from the files of the one before.

The first half is the tutorial on data and training, run as it stands.
"""

import json
import os
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
TUTORIAL = "docs/tutorials/data_and_training.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where the tutorial ran: two objects, their dataset in data/, the model trained on it in run/, its draws in out/."""
    return tmp_path_factory.mktemp("end_to_end")


@pytest.fixture(scope="module")
def commands(folder, run_page) -> dict[str, tuple[int, str]]:
    """Exit code and output of the tutorial's commands."""
    return run_page(TUTORIAL, folder)


def test_from_objects_to_verified_configurations(dexnudge, folder, commands):
    objects, run, out = (folder / name for name in ("objects", "run", "out"))
    assert {code for code, _ in commands.values()} == {0}

    info = commands["dexnudge dataset info data"][1]
    assert info.startswith("hand shadow_lite: ")
    kept = int(info.split()[2])
    assert kept >= 10
    assert "2 objects (0 not generated yet, 0 failed)" in info
    checked = commands["dexnudge dataset check data --objects objects --num 5"][1]
    assert checked == f"{kept} configurations of 2 objects read, 5 verified again: all agree\n"

    assert sorted(os.listdir(run / "model")) == ["README.md", "config.json", "model.safetensors"]

    assert dexnudge("check", out).code == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["verified"] >= 1  # projection alone reaches this; the model has seen next to nothing

    options = ["--objects", objects, "--scenes", "table", "layers", "--weights", run / "model", "--num", 4]
    outcome = dexnudge("evaluate", *options, "--out", folder / "experiment", "--workers", 1)
    assert outcome.code == 0, outcome.err
    assert "| table | steered_noise | 2 | 0 | 8 |" in outcome.out
    assert "| layers | steered_noise | 2 | 0 | 8 |" in outcome.out
    again = dexnudge("evaluate", *options, "--out", folder / "experiment", "--workers", 1)
    assert again.out == outcome.out


@pytest.mark.usefixtures("commands")
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
