"""A model as one folder, and the state of an unfinished training run. No pickle anywhere.

A model folder holds `model.safetensors` (weights and normaliser) and `config.json`.
"""

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load as parse_tensors
from safetensors.torch import save
from torch import Tensor

from dexnudge.diffusion.config import SLIDES_ONLY, ModelConfig
from dexnudge.diffusion.network import ConditionalDenoiser, Normaliser
from dexnudge.errors import LARGEST_SEED, CheckpointError, quote
from dexnudge.geometry.devices import own_modes
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.jobs.json_files import read_json_object, unique_keys

SHIPPED_WEIGHTS = Path(__file__).parent.parent / "weights"  # a model folder for each hand, by its name
WEIGHTS_NAME = "model.safetensors"
CONFIG_NAME = "config.json"
_NETWORK, _NORMALISER = "network.", "normaliser."

ROOMY = 8  # times the weights of a file: what its network may take while it is built to compare shapes


def save_model(
    folder: Path | str,
    config: ModelConfig,
    weights: dict[str, Tensor],
    normaliser: Normaliser,
    *,
    dtype: torch.dtype = torch.float16,
    provenance: dict[str, object] | None = None,
) -> Path:
    """Write a model folder and return it: the weights as `dtype`, the normaliser as float32.

    Each file appears whole or not at all, and `config.json`, written last, carries the hash of the weights it belongs to.
    weights: `state_dict` of a `ConditionalDenoiser`; provenance: what it was trained on, for the reader.

    Raises:
        CheckpointError: a weight is not finite as `dtype`.
        OutputError: the folder cannot be written.
    """
    folder = Path(folder)
    tensors = {_NETWORK + name: tensor.detach().to("cpu", dtype).contiguous() for name, tensor in weights.items()}
    tensors[_NORMALISER + "mean"] = normaliser.mean.cpu().contiguous()
    tensors[_NORMALISER + "std"] = normaliser.std.cpu().contiguous()
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise CheckpointError(f"weight {name} is not finite as {dtype}; store it as float32 or train again.")
    data = _bytes(tensors)
    with replace_atomically(folder / WEIGHTS_NAME) as temporary:
        temporary.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    content = {"model": config.to_dict(), "weights_sha256": digest, "provenance": provenance or {}}
    with replace_atomically(folder / CONFIG_NAME) as temporary:
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return folder


def _bytes(tensors: dict[str, Tensor], metadata: dict[str, str] | None = None) -> bytes:
    """Return the content of a safetensors file: `save_file` makes it private, and has an error of its own on a full disk."""
    try:
        return save(tensors, metadata)
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # of Rust, where there is no memory; it has no name to import
            raise
        raise MemoryError(
            f"{sum(each.nbytes for each in tensors.values()) / 1e6:.0f} MB of weights to write"
        ) from error


def shipped_or_given(model: str) -> Path:
    """Return the model folder that `model` means: the shipped weights of a hand by its name, else the path of a folder."""
    shipped = SHIPPED_WEIGHTS / model
    return shipped if Path(model).name == model and (shipped / CONFIG_NAME).is_file() else Path(model)


@own_modes()
def load_model(folder: Path | str) -> tuple[ConditionalDenoiser, Normaliser]:
    """Read a model folder; the network comes in evaluation mode, float32, without gradients of its weights.

    Weights from before objects could turn get columns of zeros for it: what they draw for slides stays the same, to the bit.

    Raises:
        CheckpointError: a file is missing, truncated, foreign, of another version, or does not fit the other one; or it
            holds sizes or numbers that no trained model has.
    """
    folder = Path(folder)
    content = _read_config(folder / CONFIG_NAME)
    config = ModelConfig.from_dict(content["model"])
    path = folder / WEIGHTS_NAME
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; expected it beside {CONFIG_NAME}; copy the whole folder.")
    data = path.read_bytes()
    try:
        tensors = parse_tensors(data)
    except SafetensorError as error:
        raise CheckpointError(
            f"{path} ({len(data)} bytes) cannot be read: truncated or not safetensors ({error}); copy or train it again."
        ) from error
    if hashlib.sha256(data).hexdigest() != content["weights_sha256"]:
        raise CheckpointError(
            f"{path} is not the file that {CONFIG_NAME} was written for: its SHA-256 differs; "
            "copy both files from the same model."
        )
    if content["model"]["config_version"] == SLIDES_ONLY:
        tensors.setdefault(_NETWORK + "turn_embedding", torch.zeros(config.architecture.width, 3))
    device = _building_device(tensors, config)
    with torch.device(device):
        network = ConditionalDenoiser(config)
    _check_tensors(path, tensors, network, config)
    if device == "meta":
        network = ConditionalDenoiser(config)
    network.load_state_dict(
        {name.removeprefix(_NETWORK): tensor for name, tensor in tensors.items() if name.startswith(_NETWORK)}
    )
    normaliser = Normaliser(mean=tensors[_NORMALISER + "mean"], std=tensors[_NORMALISER + "std"])
    return network.train(mode=False).requires_grad_(requires_grad=False), normaliser


def _check_tensors(path: Path, tensors: dict[str, Tensor], network: ConditionalDenoiser, config: ModelConfig) -> None:
    """Refuse tensors of other shapes than the network's, and values that no trained model has."""
    expected = {_NETWORK + name: tensor.shape for name, tensor in network.state_dict().items()}
    expected |= {_NORMALISER + name: torch.Size([config.dimension]) for name in ("mean", "std")}
    found = {name: tensor.shape for name, tensor in tensors.items()}
    if found != expected:
        wrong = min(name for name, _ in set(expected.items()) ^ set(found.items()))
        raise CheckpointError(
            f"{path} does not hold the weights that {CONFIG_NAME} describes: {wrong} has shape "
            f"{_shape(found, wrong)}, expected {_shape(expected, wrong)}; copy both files from the same model."
        )
    for name, tensor in tensors.items():
        if not tensor.is_floating_point() or not torch.isfinite(tensor).all():
            raise CheckpointError(f"{path} holds {name} that is not finite; copy or train it again.")
    if not (tensors[_NORMALISER + "std"] > 0.0).all():
        raise CheckpointError(f"{path} holds a normaliser whose std is not above 0; copy or train it again.")


def _building_device(tensors: dict[str, Tensor], config: ModelConfig) -> str:
    """Return "meta" (shapes alone, no memory) for a config of more weights than there are, else "cpu".

    What torch imports for the first costs a second, so it is kept for configs that name absurd sizes.
    """
    shape = config.architecture
    widest = max(shape.width * shape.mlp_ratio, shape.feature_width, *shape.encoder_widths, config.dimension)
    layers = shape.depth + len(shape.encoder_widths)
    there = sum(tensor.numel() for tensor in tensors.values())
    return "cpu" if layers * widest**2 <= ROOMY * there else "meta"


def read_provenance(folder: Path | str) -> dict[str, Any]:
    """Return what the model was trained on, as `save_model` was told; raises CheckpointError."""
    return _read_config(Path(folder) / CONFIG_NAME)["provenance"]


def _shape(shapes: dict[str, torch.Size], name: str) -> str:
    return str(tuple(shapes[name])) if name in shapes else "no entry"


def _read_config(path: Path) -> dict[str, Any]:
    expected = (
        f"a model folder with {CONFIG_NAME} and {WEIGHTS_NAME}; make one with `dexnudge train` or correct the path"
    )
    content = read_json_object(path, error=CheckpointError, expected=expected, again="copy the model again")
    keys = {"model", "weights_sha256", "provenance"}
    if set(content) != keys or not isinstance(content["model"], dict):
        raise CheckpointError(f"{path} was not written by dexnudge: expected the keys {', '.join(sorted(keys))}.")
    return content


MODEL_FOLDER, LOG_NAME = "model", "train.jsonl"  # in the folder of a run, beside its state
STATE_NAME = "training_state.safetensors"
FIGURE = re.compile(r"[\w/.-]+")  # names in a state's header
_DIGEST = "sha256"  # in a state's header, of the file without it; states from before 0.19.0 have none
STATE_VERSION = 1  # raised whenever the optimiser or the order of random draws changes


def save_state(folder: Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> None:
    """Write a run's tensors and its header: step, minutes, validation, loss, and what names it (`TrainingRun.identity`)."""
    on_cpu = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    header = {"version": STATE_VERSION, **header}
    data = _state_bytes(on_cpu, {**header, _DIGEST: hashlib.sha256(_state_bytes(on_cpu, header)).hexdigest()})
    with replace_atomically(folder / STATE_NAME) as temporary:
        temporary.write_bytes(data)


def _state_bytes(tensors: dict[str, Tensor], header: dict[str, Any]) -> bytes:
    return _bytes(tensors, {"training": json.dumps(header)})


def load_state(folder: Path, identity: dict[str, Any]) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """Return tensors and header of the state saved in `folder`, or None if there is none.

    Raises:
        CheckpointError: it is damaged or belongs to another run: other settings, dataset or version.
    """
    path = folder / STATE_NAME
    if not path.is_file():
        if path.exists():
            raise CheckpointError(f"{path} is no file; expected the state of a run; delete it to start again.")
        return None
    with _opened(path) as (header, file):
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    digest = header.pop(_DIGEST, None)
    if digest is not None and digest != hashlib.sha256(_state_bytes(tensors, header)).hexdigest():
        raise CheckpointError(
            f"{path} is damaged: its SHA-256 is not the one that it was written with; delete it to start again."
        )
    ours = json.loads(json.dumps({"version": STATE_VERSION, **identity}))  # tuples become lists, as in the file
    found, expected = _flat({name: header.get(name) for name in ours}), _flat(ours)
    names = sorted(name for name in {*found, *expected} if found.get(name) != expected.get(name))
    if names:
        differences = "; ".join(f"{name} was {found.get(name)!r}, is now {expected.get(name)!r}" for name in names)
        raise CheckpointError(
            f"{path} belongs to another run and cannot be continued: {differences}; "
            "use the same settings, or another output folder."
        )
    return tensors, header


def read_state_header(folder: Path | str) -> dict[str, Any]:
    """Return step, minutes, dataset and settings (config) of the run in `folder`; CheckpointError without a state."""
    path = Path(folder) / STATE_NAME
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; expected the folder of a run of `dexnudge train`.")
    with _opened(path) as (header, _):
        return {name: value for name, value in header.items() if name != _DIGEST}


@contextmanager
def _opened(path: Path) -> Iterator[tuple[dict[str, Any], Any]]:
    """Header and tensors of a state file; CheckpointError when it is damaged."""
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads(file.metadata()["training"], object_pairs_hook=unique_keys)
            _check_header(header)
            yield header, file
    except (SafetensorError, KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(
            f"{path} cannot be read: truncated or not a training state ({error}); delete it to start again."
        ) from error


def _check_header(header: dict[str, Any]) -> None:
    """Refuse a header that no run writes; KeyError, TypeError or ValueError."""
    step, minutes, loss, steps = header["step"], header["minutes"], header.get("loss", 0.0), header["config"]["steps"]
    counts = (("step", step, (int,)), ("minutes", minutes, (int, float)), ("steps", steps, (int,)))
    wrong = [
        (name, value) for name, value, kinds in counts if type(value) not in kinds or not 0 <= value <= LARGEST_SEED
    ]
    validation = header.get("validation", {})
    figures = {"loss": loss, **(validation if type(validation) is dict else {"validation": None})}
    wrong += [each for each in figures.items() if not FIGURE.fullmatch(each[0]) or not _is_figure(each[1])]
    if wrong:
        raise ValueError(f"{wrong[0][0]} is {quote(wrong[0][1])}")


def _is_figure(value: Any) -> bool:
    return type(value) is float or (type(value) is int and abs(value) <= LARGEST_SEED)  # NaN where a run has diverged


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    """Nested settings under names like `architecture.width`; those of `config` without a prefix."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        prefix = "" if name == "config" else f"{name}."
        flat |= {prefix + k: v for k, v in _flat(value).items()} if isinstance(value, dict) else {name: value}
    return flat
