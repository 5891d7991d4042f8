"""The card says what the files of the run say."""

import json
import shutil

import pytest

from dexnudge.dataset.loading import load_dataset
from dexnudge.diffusion.checkpoint import CONFIG_NAME
from dexnudge.diffusion.config import TrainingConfig
from dexnudge.diffusion.model_card import write_model_card
from dexnudge.diffusion.training import train
from dexnudge.errors import CheckpointError


@pytest.fixture(scope="module")
def run_folder(toy, architecture, tmp_path_factory):
    folder = tmp_path_factory.mktemp("card")
    toy.write_toy_dataset(folder / "data")
    config = TrainingConfig(
        steps=30,
        groups=2,
        rows_per_group=4,
        num_points=32,
        validate_every=1,
        log_every=1,
        architecture=architecture,
    )
    train(folder / "data", folder / "run", config, made_with={"processor": "an abacus", "torch": "0.1"})
    return folder / "run"


def section(text, title):
    return text.split(f"## {title}\n\n")[1].split("\n\n## ")[0]


def test_numbers_are_those_of_the_run(run_folder):
    text = (run_folder / "model" / "README.md").read_text()
    provenance = json.loads((run_folder / "model" / CONFIG_NAME).read_text())["provenance"]
    events = [json.loads(line) for line in (run_folder / "train.jsonl").read_text().splitlines()]
    validations = [event for event in events if "validation/loss" in event]
    assert "| steps | 30, each of 8 configurations |" in text
    assert "| processor | an abacus |" in text
    assert "| torch | 0.1 |" in text
    assert f"data, {len(load_dataset(run_folder.parent / 'data'))} configurations. " in text
    assert all(name in section(text, "Data") for name in provenance["held_out_objects"])
    last = validations[-1]
    for level in ("0.05", "0.25", "0.5", "0.75"):
        errors = [last[f"validation/{kind}_at_{level}"] for kind in ("translation_mm", "joints_deg")]
        assert f"| {level} | {errors[0]:.4g} | {errors[1]:.4g} |" in section(text, "Validation")
    curve = [line.split(" | ") for line in section(text, "Learning curve").splitlines()[2:]]
    assert [int(row[0].strip("| ")) for row in curve] == list(range(3, 31, 3))
    assert [float(row[2]) for row in curve] == pytest.approx(
        [v["validation/loss"] for v in validations[2::3]], rel=1e-3
    )


def test_no_run(run_folder, tmp_path):
    with pytest.raises(CheckpointError, match=r"config.json: no such file"):
        write_model_card(tmp_path)
    shutil.copytree(run_folder / "model", tmp_path / "model")
    with pytest.raises(CheckpointError, match="expected the folder of a run of `dexnudge train`"):
        write_model_card(tmp_path)
