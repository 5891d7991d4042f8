"""A model as one folder: `model.safetensors` (weights and normaliser) and `config.json`. No pickle anywhere."""

import hashlib
import json
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load as parse_tensors
from safetensors.torch import save as serialise_tensors
from torch import Tensor

from dexnudge.diffusion.config import ModelConfig
from dexnudge.diffusion.network import ConditionalDenoiser
from dexnudge.diffusion.normaliser import Normaliser
from dexnudge.errors import CheckpointError
from dexnudge.jobs.folders import replace_atomically

WEIGHTS_NAME = "model.safetensors"
CONFIG_NAME = "config.json"
_NETWORK, _NORMALISER = "network.", "normaliser."


def save_model(
    folder: Path | str,
    config: ModelConfig,
    weights: dict[str, Tensor],
    normaliser: Normaliser,
    *,
    dtype: torch.dtype = torch.float16,
    provenance: dict[str, object] | None = None,
) -> Path:
    """Write a model folder and return it.

    weights: `state_dict` of a `ConditionalDenoiser`, stored as `dtype`; the normaliser stays float32. provenance: what it
    was trained on, for the reader. Each file appears whole or not at all, and `config.json`, written last, carries the
    hash of the weights it belongs to.
    """
    folder = Path(folder)
    tensors = {_NETWORK + name: tensor.detach().to("cpu", dtype).contiguous() for name, tensor in weights.items()}
    tensors[_NORMALISER + "mean"] = normaliser.mean.cpu().contiguous()
    tensors[_NORMALISER + "std"] = normaliser.std.cpu().contiguous()
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise CheckpointError(f"weight {name} is not finite as {dtype}; store it as float32 or train again.")
    weights_path = folder / WEIGHTS_NAME
    with replace_atomically(weights_path) as temporary:
        data = serialise_tensors(tensors)  # save_file would make the file private to its owner
        temporary.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    content = {"model": config.to_dict(), "weights_sha256": digest, "provenance": provenance or {}}
    with replace_atomically(folder / CONFIG_NAME) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return folder


def load_model(folder: Path | str) -> tuple[ConditionalDenoiser, Normaliser]:
    """Read a model folder; the network comes in evaluation mode, float32, without gradients of its weights.

    Raises CheckpointError when a file is missing, truncated, foreign, of another version, or does not fit the other one.
    """
    folder = Path(folder)
    content = _read_config(folder / CONFIG_NAME)
    config = ModelConfig.from_dict(content["model"])
    weights_path = folder / WEIGHTS_NAME
    if not weights_path.is_file():
        raise CheckpointError(
            f"{weights_path} does not exist; expected it beside {CONFIG_NAME}; copy the whole folder."
        )
    data = weights_path.read_bytes()
    try:
        tensors = parse_tensors(data)
    except SafetensorError as error:
        raise CheckpointError(
            f"{weights_path} ({len(data)} bytes) cannot be read: truncated or not safetensors ({error}); "
            "copy or train it again."
        ) from error
    if hashlib.sha256(data).hexdigest() != content["weights_sha256"]:
        raise CheckpointError(
            f"{weights_path} is not the file that {CONFIG_NAME} was written for: its SHA-256 differs; "
            "copy both files from the same model."
        )
    network = ConditionalDenoiser(config)
    expected = {_NETWORK + name: tensor.shape for name, tensor in network.state_dict().items()}
    expected |= {_NORMALISER + name: torch.Size([config.dimension]) for name in ("mean", "std")}
    found = {name: tensor.shape for name, tensor in tensors.items()}
    if found != expected:
        wrong = min(name for name, _ in set(expected.items()) ^ set(found.items()))
        raise CheckpointError(
            f"{weights_path} does not hold the weights that {CONFIG_NAME} describes: {wrong} has shape "
            f"{_shape(found, wrong)}, expected {_shape(expected, wrong)}; copy both files from the same model."
        )
    network.load_state_dict(
        {name.removeprefix(_NETWORK): tensor.float() for name, tensor in tensors.items() if name.startswith(_NETWORK)}
    )
    normaliser = Normaliser(mean=tensors[_NORMALISER + "mean"], std=tensors[_NORMALISER + "std"])
    return network.train(mode=False).requires_grad_(requires_grad=False), normaliser


def read_provenance(folder: Path | str) -> dict[str, object]:
    """What the model was trained on, as `save_model` was told."""
    return _read_config(Path(folder) / CONFIG_NAME)["provenance"]


def _shape(shapes: dict[str, torch.Size], name: str) -> str:
    return str(tuple(shapes[name])) if name in shapes else "no entry"


def _read_config(path: Path) -> dict:
    if not path.is_file():
        raise CheckpointError(
            f"{path} does not exist; expected a model folder with {CONFIG_NAME} and {WEIGHTS_NAME}; "
            "make one with `dexnudge train` or correct the path."
        )
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise CheckpointError(f"{path} is not valid JSON ({error}); copy the model again.") from error
    keys = {"model", "weights_sha256", "provenance"}
    if not isinstance(content, dict) or set(content) != keys or not isinstance(content["model"], dict):
        raise CheckpointError(f"{path} was not written by dexnudge: expected the keys {', '.join(sorted(keys))}.")
    return content
