"""Weights of a model and of the losses: what cannot be used is refused, and what is used stands in the summary."""

import json
import os
import shutil
from pathlib import Path

import pytest

from dexnudge.diffusion.checkpoint import SHIPPED_WEIGHTS
from dexnudge.hands.export import export_hand

RESULTS = ("configurations.npz", "summary.json", "model", "report.md")
SCENE = ["sample", "phone", "--scene", "table"]
QUICK = ["--method", "random_start_projection", "--num", 2]


def refusal(dexnudge, tmp_path, *arguments) -> str:
    """The message of a command that must be refused and leave no draws."""
    outcome = dexnudge(*arguments, "--out", tmp_path / "out")
    assert outcome.code == 2, outcome.err
    assert outcome.err.count("\n") == 1
    assert not any(name in os.listdir(tmp_path / "out") for name in RESULTS if (tmp_path / "out").exists())
    return outcome.err


@pytest.fixture
def model(tmp_path) -> Path:
    """A copy of the shipped model that a test may damage."""
    return Path(shutil.copytree(SHIPPED_WEIGHTS / "shadow_lite", tmp_path / "model"))


def edit(path: Path, function) -> None:
    content = json.loads(path.read_text())
    function(content)
    path.write_text(json.dumps(content))


def test_weights_of_another_hand(dexnudge, tmp_path, model):
    message = refusal(dexnudge, tmp_path, *SCENE, "--hand", "shadow_full", "--weights", model)
    assert message.startswith(f"dexnudge: {model} was trained for hand 'shadow_lite' with joints FFJ4, FFJ3")
    assert "but hand 'shadow_full' has joints" in message
    assert message.endswith("train a model for this hand with `dexnudge train`.\n")


def test_a_hand_without_weights(dexnudge, tmp_path, boxy_hand):
    message = refusal(dexnudge, tmp_path, *SCENE, "--hand", export_hand(boxy_hand, tmp_path / "hand"))
    assert "no weights for hand 'boxy': expected a model folder, got none beside it and none that ship" in message
    assert "learn some with `dexnudge hand HAND --learn`, pass a model folder as --weights" in message


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda content: content["model"].update(config_version=7), "model config has version 7, expected 1"),
        (lambda content: content.pop("weights_sha256"), "was not written by dexnudge: expected the keys"),
        (
            lambda content: content.update(weights_sha256="0"),
            "its SHA-256 differs; copy both files from the same model",
        ),
    ],
    ids=["version", "format", "another model's weights"],
)
def test_a_model_of_another_version_or_format(dexnudge, tmp_path, model, change, expected):
    edit(model / "config.json", change)
    assert expected in refusal(dexnudge, tmp_path, *SCENE, "--weights", model)


def test_weights_that_are_a_pickle(dexnudge, tmp_path, model):
    (model / "model.safetensors").write_bytes(b"\x80\x04\x95\x0c\x00\x00\x00\x00\x00\x00\x00.")
    message = refusal(dexnudge, tmp_path, *SCENE, "--weights", model)
    assert "(12 bytes) cannot be read: truncated or not safetensors" in message


@pytest.mark.parametrize("command", ["train", "evaluate"])
def test_a_dataset_of_another_version(dexnudge, tmp_path, command):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "manifest.json").write_text(json.dumps({"format_version": 99}))
    options = {"train": [], "evaluate": ["--objects", "builtin:test", "--method", "nearest_pose", "--workers", 1]}
    message = refusal(dexnudge, tmp_path, command, "--data", tmp_path / "data", *options[command])
    assert "manifest.json has format version 99, expected 2; generate the dataset again" in message


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (
            ["--weight-sweep", -1],
            "the weight 'sweep' of the energy is -1; expected a number from 0 to 1e+06; 0 switches it off",
        ),
        (["--weight-force", "nan"], "the weight 'force' of the energy is nan; expected a number from 0 to 1e+06"),
        (["--weight-contact", "inf"], "the weight 'contact' of the energy is inf; expected a number from 0 to 1e+06"),
        (
            ["--clearance-base", -0.01],
            "the distance 'clearance_base' of the energy is -0.01; expected a number from 0 to 1e+06",
        ),
    ],
)
def test_losses_that_make_no_sense(dexnudge, tmp_path, options, expected):
    assert expected in refusal(dexnudge, tmp_path, *SCENE, *options)
    assert expected in refusal(dexnudge, tmp_path, "evaluate", "--objects", "builtin:test", *options)
    assert os.listdir(tmp_path) == []


def test_an_experiment_belongs_to_its_losses(dexnudge, tmp_path):
    (tmp_path / "objects").mkdir()
    for name in ("a", "b"):
        (tmp_path / "objects" / f"{name}.obj").write_text("v 0 0 0\n")  # cannot be read: a failed row, and soon
    command = ["evaluate", "--objects", tmp_path / "objects", "--max-objects", 1, "--scenes", "table", "--workers", 1]
    command += ["--method", "random_start_projection", "--num", 2, "--out", tmp_path / "out"]
    outcome = dexnudge(*command, "--weight-sweep", 0, "--clearance-base", 0.02)
    assert outcome.code == 0, outcome.err
    assert "Losses other than each method's own: sweep 0, clearance_base 0.02." in outcome.out
    assert "| table | random_start_projection | 1 | 1 |" in outcome.out
    config = json.loads((tmp_path / "out" / "experiment.json").read_text())["config"]
    assert (config["losses"], config["max_objects"]) == ({"sweep": 0.0, "clearance_base": 0.02}, 1)
    other = dexnudge(*command)
    assert other.code == 2
    assert "holds another experiment: losses is {'sweep': 0.0, 'clearance_base': 0.02} there and None here" in other.err


def test_the_summary_says_with_which_losses_and_a_folder_that_is_left_out_is_numbered(dexnudge, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "phone-table").mkdir(parents=True)
    losses = ["--weight-sweep", 0, "--weight-force", 0, "--weight-base", 0.5, "--clearance-base", 0.02]
    outcome = dexnudge(*SCENE, *QUICK, *losses)
    assert outcome.code in (0, 3), outcome.err
    assert outcome.out.endswith("written: runs/phone-table-2\n")
    assert sorted(os.listdir("runs")) == ["phone-table", "phone-table-2"]
    energy = json.loads((tmp_path / "runs" / "phone-table-2" / "summary.json").read_text())["energy"]
    assert list(energy) == ["projection"], "this method guides nothing"
    used = energy["projection"]
    assert (used["sweep"], used["force"], used["base"], used["clearance_base"]) == (0.0, 0.0, 0.5, 0.02)
    assert used["object"] == 1.0
