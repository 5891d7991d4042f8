"""The card says what the files of the run say."""

import dataclasses
import json
import re
import shutil

import pytest

from dexnudge.dataset.loading import load_dataset
from dexnudge.diffusion.checkpoint import CONFIG_NAME
from dexnudge.diffusion.config import Architecture
from dexnudge.diffusion.model_card import training_recipe, write_model_card
from dexnudge.diffusion.training import train
from dexnudge.diffusion.training_config import TrainingConfig
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
    train(folder / "data", folder / "run", config, progress=False, made_with={"processor": "an abacus", "torch": "0.1"})
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


def test_a_run_that_recorded_less(run_folder, tmp_path):
    """A run of an earlier version: no versions, no machine, no budget, no newer settings."""
    folder = shutil.copytree(run_folder, tmp_path / "run")
    path = folder / "model" / CONFIG_NAME
    content = json.loads(path.read_text())
    provenance = content["provenance"]
    for name in ("data", "made_with"):
        provenance.pop(name)
    for name in ("scale_jitter", "device", "precision", "processes", "max_minutes"):
        provenance["config"].pop(name)
    provenance["config"]["architecture"].pop("token_layout")
    provenance["config"]["steps"] = 1000
    path.write_text(json.dumps(content))
    text = write_model_card(folder).read_text()
    assert "| versions and machine | not recorded |" in text
    assert "| `scale_jitter` | 0.0 |" in text
    assert "| `token_layout` | digits |" in text
    assert "| torch | 0.2 |" in write_model_card(folder, made_with={"torch": "0.2"}).read_text()


def test_no_run(run_folder, tmp_path):
    with pytest.raises(CheckpointError, match="does not exist"):
        write_model_card(tmp_path)
    shutil.copytree(run_folder / "model", tmp_path / "model")
    with pytest.raises(CheckpointError, match="expected the folder of a run of `dexnudge train`"):
        write_model_card(tmp_path)


def test_settings_without_an_option_are_set_from_python():
    config = TrainingConfig(steps=7, ema_decay=0.5, architecture=Architecture(encoder_widths=(8, 16), width=32))
    settings = json.loads(json.dumps({**dataclasses.asdict(config), "processes": 1}))
    code = re.fullmatch(r"```python\n(.*)\n```", training_recipe(settings), re.DOTALL)[1]
    names = {"DATA": "data", "RUN": "run"}
    asked = []
    code = code.replace("from dexnudge.diffusion.training import train\n", "")
    exec(code, names | {"train": lambda *arguments: asked.append(arguments)})  # noqa: S102 - what the card tells to run
    assert asked == [("data", "run", config)]
