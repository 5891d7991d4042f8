"""The state of an unfinished training run: one safetensors file, replaced atomically."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from dexnudge.errors import CheckpointError
from dexnudge.jobs.folders import replace_atomically

STATE_NAME = "training_state.safetensors"
STATE_VERSION = 1  # raised whenever the optimiser or the order of random draws changes
# what a state means that was written before the setting existed
SETTINGS_BEFORE = {
    "scale_jitter": 0.0,
    "device": "cpu",
    "precision": "float32",
    "processes": 1,
    "architecture.token_layout": "digits",
}


@dataclass(kw_only=True)
class TrainingState:
    """Everything that decides how the run goes on; random draws depend on the step alone.

    step: steps done; minutes: time spent on them; weights, average, first_moment, second_moment: by parameter name;
    validation: the figures last found.
    """

    step: int
    minutes: float
    weights: dict[str, Tensor]
    average: dict[str, Tensor]
    first_moment: dict[str, Tensor]
    second_moment: dict[str, Tensor]
    validation: dict[str, float] = field(default_factory=dict)


_GROUPS = ("weights", "average", "first_moment", "second_moment")


def save_state(folder: Path, state: TrainingState, settings: dict[str, Any], dataset_id: str) -> None:
    """Write the state with the settings and the dataset of the run that it belongs to."""
    tensors = {
        f"{group}/{name}": tensor.detach().cpu().contiguous()
        for group in _GROUPS
        for name, tensor in getattr(state, group).items()
    }
    header = {
        "version": STATE_VERSION,
        "step": state.step,
        "minutes": state.minutes,
        "validation": state.validation,
        "dataset": dataset_id,
        "config": settings,
    }
    with replace_atomically(folder / STATE_NAME) as temporary:
        save_file(tensors, temporary, metadata={"training": json.dumps(header)})


def load_state(folder: Path, settings: dict[str, Any], dataset_id: str) -> TrainingState | None:
    """The state saved in `folder`, or None if there is none.

    Raises CheckpointError when it is truncated or belongs to another run: other settings, dataset or version.
    """
    path = folder / STATE_NAME
    if not path.is_file():
        return None
    tensors: dict[str, dict[str, Tensor]] = {group: {} for group in _GROUPS}
    with _opened(path) as (header, file):
        for key in file.keys():  # noqa: SIM118 - not a dict
            group, name = key.split("/", 1)
            tensors[group][name] = file.get_tensor(key)
    _check_identity(path, header, settings, dataset_id)
    validation = header.get("validation", {})  # not in the first states that were written
    return TrainingState(step=header["step"], minutes=header["minutes"], validation=validation, **tensors)


def read_header(folder: Path) -> dict[str, Any]:
    """Steps, minutes, dataset and settings of the run in `folder`; CheckpointError when it has no readable state."""
    path = folder / STATE_NAME
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; expected the folder of a run of `dexnudge train`.")
    with _opened(path) as (header, _):
        return header


@contextmanager
def _opened(path: Path) -> Iterator[tuple[dict[str, Any], Any]]:
    """Header and tensors of a state file; CheckpointError when it is damaged."""
    try:
        with safe_open(path, framework="pt") as file:
            yield json.loads(file.metadata()["training"]), file
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise CheckpointError(
            f"{path} cannot be read: truncated or not a training state ({error}); delete it to start again."
        ) from error


def _check_identity(path: Path, header: dict, settings: dict[str, Any], dataset_id: str) -> None:
    identity = json.loads(json.dumps(settings))  # tuples become lists, as in the file
    saved = {**SETTINGS_BEFORE, **_flat(header.get("config", {}))}
    found = {"version": header.get("version"), "dataset": header.get("dataset"), **saved}
    expected = {"version": STATE_VERSION, "dataset": dataset_id, **_flat(identity)}
    names = sorted(name for name in {*found, *expected} if found.get(name) != expected.get(name))
    if names:
        differences = "; ".join(f"{name} was {found.get(name)!r}, is now {expected.get(name)!r}" for name in names)
        raise CheckpointError(
            f"{path} belongs to another run and cannot be continued: {differences}; "
            "use the same settings, or another output folder."
        )


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """Nested settings under names like `architecture.width`."""
    inner = {name: value for name, value in settings.items() if isinstance(value, dict)}
    outer = {name: value for name, value in settings.items() if name not in inner}
    return outer | {f"{name}.{key}": value for name, values in inner.items() for key, value in values.items()}


def restore_moments(optimizer: torch.optim.Optimizer, named: dict[str, Tensor], state: TrainingState) -> None:
    """Give an AdamW over the parameters `named` its moments back."""
    for name, parameter in named.items():
        optimizer.state[parameter] = {
            "step": torch.tensor(float(state.step), device=parameter.device),
            "exp_avg": state.first_moment[name].to(parameter.device, copy=True),
            "exp_avg_sq": state.second_moment[name].to(parameter.device, copy=True),
        }
