"""A model folder gives back what went in, and every kind of damage is named."""

import hashlib
import json
import pickle

import pytest
import torch
from safetensors.torch import load_file, save_file

from dexnudge.diffusion import checkpoint
from dexnudge.diffusion.checkpoint import CONFIG_NAME, WEIGHTS_NAME, load_model, read_provenance, save_model
from dexnudge.errors import CheckpointError


@pytest.fixture
def folder(network, normaliser, config, tmp_path):
    return save_model(tmp_path, config, network.state_dict(), normaliser, provenance={"objects": 3})


def test_round_trip(folder, network, normaliser, config):
    loaded, found = load_model(folder)
    assert loaded.config == config
    assert not loaded.training
    assert not any(parameter.requires_grad for parameter in loaded.parameters())
    for name, tensor in network.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor.half().float())
    assert torch.equal(found.mean, normaliser.mean)
    assert torch.equal(found.std, normaliser.std)
    assert read_provenance(folder) == {"objects": 3}
    assert sorted(path.name for path in folder.iterdir()) == [CONFIG_NAME, WEIGHTS_NAME]


@pytest.mark.parametrize(("roomy", "built"), [(checkpoint.ROOMY, 1), (0, 2)])
def test_the_network_is_built_once_unless_its_config_names_more_weights_than_there_are(
    roomy, built, folder, network, monkeypatch
):
    made = []

    class Counted(checkpoint.ConditionalDenoiser):
        def __init__(self, *arguments):
            made.append(self)
            super().__init__(*arguments)

    monkeypatch.setattr(checkpoint, "ConditionalDenoiser", Counted)
    monkeypatch.setattr(checkpoint, "ROOMY", roomy)
    loaded, _ = load_model(folder)
    assert len(made) == built
    assert all(
        torch.equal(loaded.state_dict()[name], each.half().float()) for name, each in network.state_dict().items()
    )


def test_no_memory_for_the_bytes_is_a_lack_of_memory(network, normaliser, config, tmp_path, monkeypatch):
    class PanicException(BaseException):
        pass

    def panic(*_):
        raise PanicException

    monkeypatch.setattr(checkpoint, "save", panic)
    with pytest.raises(MemoryError, match="MB of weights to write"):
        save_model(tmp_path, config, network.state_dict(), normaliser)


def test_float32_keeps_every_bit(network, normaliser, config, tmp_path):
    save_model(tmp_path, config, network.state_dict(), normaliser, dtype=torch.float32)
    loaded, _ = load_model(tmp_path)
    assert all(torch.equal(loaded.state_dict()[name], tensor) for name, tensor in network.state_dict().items())


def test_files_can_be_read_by_others(folder):
    assert all(path.stat().st_mode & 0o044 == 0o044 for path in folder.iterdir())


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.999])
def test_truncated_weights(folder, share):
    path = folder / WEIGHTS_NAME
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(CheckpointError, match=r"model.safetensors \(\d+ bytes\) cannot be read: truncated"):
        load_model(folder)


def test_a_pickle_is_not_read(folder):
    (folder / WEIGHTS_NAME).write_bytes(pickle.dumps({"weights": [1, 2, 3]}))
    with pytest.raises(CheckpointError, match="truncated or not safetensors"):
        load_model(folder)


def test_weights_of_another_model(folder):
    tensors = load_file(folder / WEIGHTS_NAME)
    tensors["network.token_position"] += 1.0
    save_file(tensors, folder / WEIGHTS_NAME)
    with pytest.raises(
        CheckpointError, match=r"is not the file that config\.json was written for: its SHA-256 differs"
    ):
        load_model(folder)


@pytest.mark.parametrize("name", [WEIGHTS_NAME, CONFIG_NAME])
def test_missing_files(folder, name):
    (folder / name).unlink()
    with pytest.raises(CheckpointError, match=rf"{name}(: no such file| does not exist)"):
        load_model(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content["model"].update(config_version=7), "model config has version 7, expected 1 or 2"),
        (lambda content: content["model"].update(surprise=7), r"missing or unexpected fields \(.*surprise"),
        (lambda content: content["model"].pop("architecture"), r"missing or unexpected fields \('architecture'"),
        (lambda content: content["model"].update(architecture="deep"), r"missing or unexpected fields \(dictionary"),
        (
            lambda content: content["model"]["architecture"].update(depth=3),
            r"network.blocks.2.attention_out.bias has shape no entry, expected \(32,\)",
        ),
        (
            lambda content: content["model"]["architecture"].update(feature_width=64),
            r"network.encoder.head.0.bias has shape \(32,\), expected \(64,\)",
        ),
        (
            lambda content: content["model"]["architecture"].update(depth=10**9),
            r"`depth` is 1000000000; expected a whole number from 1 to 64",
        ),
        (lambda content: content["model"]["architecture"].update(width=-4), r"`width` is -4; expected a whole number"),
        (
            lambda content: content["model"]["architecture"].update(width=4096, depth=64),
            r"`width` 4096 and `depth` 64 make [\d,]+ parameters; expected at most 500,000,000",
        ),
        (lambda content: content["model"]["architecture"].update(encoder_widths=[]), "`encoder_widths` is empty"),
        (lambda content: content.pop("provenance"), "was not written by dexnudge: expected the keys model, provenance"),
    ],
)
def test_foreign_configs(folder, change, message):
    content = json.loads((folder / CONFIG_NAME).read_text())
    change(content)
    (folder / CONFIG_NAME).write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match=message):
        load_model(folder)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("network.token_position", lambda tensor: tensor.index_fill_(0, torch.tensor([0]), torch.nan), "is not finite"),
        ("normaliser.mean", lambda tensor: tensor.fill_(torch.inf), "is not finite"),
        ("normaliser.std", lambda tensor: tensor.index_fill_(0, torch.tensor([3]), 0.0), "std is not above 0"),
    ],
)
def test_numbers_that_no_trained_model_has(folder, name, change, message):
    tensors = load_file(folder / WEIGHTS_NAME)
    change(tensors[name])
    save_file(tensors, folder / WEIGHTS_NAME)
    content = json.loads((folder / CONFIG_NAME).read_text())
    content["weights_sha256"] = hashlib.sha256((folder / WEIGHTS_NAME).read_bytes()).hexdigest()
    (folder / CONFIG_NAME).write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match=message):
        load_model(folder)


def test_a_config_from_before_token_layouts_is_read(folder, network):
    content = json.loads((folder / CONFIG_NAME).read_text())
    assert content["model"]["architecture"].pop("token_layout") == "digits"
    (folder / CONFIG_NAME).write_text(json.dumps(content))
    assert load_model(folder)[0].config == network.config


def test_broken_json(folder):
    path = folder / CONFIG_NAME
    path.write_text(path.read_text()[:40])
    with pytest.raises(CheckpointError, match="cannot be read as JSON"):
        load_model(folder)


def test_weights_that_overflow_are_not_saved(network, normaliser, config, tmp_path):
    weights = network.state_dict() | {"token_position": torch.full((6, 32), 1e6)}
    with pytest.raises(CheckpointError, match=r"weight network.token_position is not finite as torch.float16"):
        save_model(tmp_path, config, weights, normaliser)
    assert list(tmp_path.iterdir()) == []
