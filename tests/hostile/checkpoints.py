"""Hostile model folders and training states; what is read well trains for two steps."""

from __future__ import annotations

import hashlib
import json
import pickle
import random
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load, save

from dataset.toy import DIGIT_JOINTS, JOINT_NAMES, write_toy_dataset
from hostile.case import CONTROL, Content, Draw, Hostile, Link, Pipe, as_content, copied
from hostile.mutations import changed_value, damaged_bytes, damaged_json, odd_values

SHAPE = {"width": 16, "depth": 1, "num_heads": 2, "mlp_ratio": 2, "encoder_widths": [8, 16], "feature_width": 16}
TRAIN = [
    "train",
    "--data",
    "data",
    "--out",
    "out",
    "--steps",
    "2",
    "--groups",
    "1",
    "--rows-per-group",
    "2",
    "--num-points",
    "16",
    "--checkpoint-every",
    "1",
    "--width",
    "16",
    "--depth",
    "1",
    "--num-heads",
    "2",
    "--mlp-ratio",
    "2",
    "--encoder-widths",
    "8",
    "16",
    "--feature-width",
    "16",
]
WEIGHTS, CONFIG, STATE = "model/model.safetensors", "model/config.json", "out/training_state.safetensors"
Tensors = dict[str, torch.Tensor]


@cache
def data() -> dict[str, bytes]:
    """Return the files of a made-up dataset."""
    folder = Path(tempfile.mkdtemp())
    write_toy_dataset(folder, num_objects=2, rows=6)
    return {f"data/{name}": content for name, content in copied(folder).items()}


@cache
def model() -> tuple[bytes, dict[str, Any]]:
    """Return weights and config of a model for it."""
    from dexnudge.diffusion.checkpoint import save_model
    from dexnudge.diffusion.config import Architecture, ModelConfig
    from dexnudge.diffusion.network import ConditionalDenoiser, Normaliser

    shape: dict[str, Any] = SHAPE | {"encoder_widths": tuple(SHAPE["encoder_widths"])}  # type: ignore[arg-type]
    config = ModelConfig(
        hand="toy",
        joint_names=JOINT_NAMES,
        joint_groups=tuple(DIGIT_JOINTS.values()),
        architecture=Architecture(**shape),
    )
    folder = Path(tempfile.mkdtemp())
    size = torch.zeros(config.dimension)
    save_model(folder, config, ConditionalDenoiser(config).state_dict(), Normaliser(mean=size, std=size + 1))
    files = copied(folder)
    return files["model.safetensors"], json.loads(files["config.json"])


@cache
def finished() -> dict[str, bytes]:
    """Return what a run of two steps on it leaves, made in a process of its own: threads of torch outlive no fork."""
    folder = Path(tempfile.mkdtemp())
    for name, content in data().items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    run = [sys.executable, "-m", "dexnudge", *TRAIN]
    subprocess.run(run, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return {name: content for name, content in copied(folder).items() if name.startswith("out/")}


def state() -> bytes:
    """Return its state."""
    return finished()[STATE]


def model_case(name: str, weights: Content, config: Any = None, expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of a model folder that a run starts from; its hash fits the weights unless `config` has one."""
    content = config
    if config is None or isinstance(config, dict):
        digest = hashlib.sha256(weights).hexdigest() if isinstance(weights, bytes) else ""
        content = as_content({**model()[1], "weights_sha256": digest, **(config or {})})
    files = {**data(), WEIGHTS: weights, CONFIG: content}
    return Hostile("model", name, files, (*TRAIN, "--start-from", "model"), expected, says)


def state_case(name: str, content: Content, expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of a run that is continued."""
    return Hostile("state", name, {**data(), **finished(), STATE: content}, tuple(TRAIN), expected, says)


def _changed_header(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    if "__metadata__" in header and rng.random() < 0.5:  # our own, inside the library's
        what, inside = damaged_json(json.loads(header["__metadata__"]["training"]), rng)
        header["__metadata__"]["training"] = inside.decode("utf-8", "replace")
    else:
        what, header = changed_value(header, rng)
    text = json.dumps(header).encode()
    return what, struct.pack("<Q", len(text)) + text + content[8 + size :]


def _damaged(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    return damaged_bytes(content, rng) if rng.random() < 0.4 else _changed_header(content, rng)


def _draw_model(rng: random.Random) -> Hostile:
    weights, config = model()
    if rng.random() < 0.4:
        return model_case(*_damaged(weights, rng))
    if rng.random() < 0.2:
        return model_case("config: " + (found := damaged_json(config, rng))[0], weights, found[1])
    inside = json.loads(json.dumps(config["model"]))
    key = rng.choice([*inside["architecture"]])
    if rng.random() < 0.5:
        inside["architecture"][key] = odd_values(rng)
        return model_case(f"another {key}", weights, {"model": inside})
    what, changed = changed_value(inside, rng)
    return model_case(f"model: {what}", weights, {"model": changed})


def _draw_state(rng: random.Random) -> Hostile:
    return state_case(*_damaged(state(), rng))


def _with(change: Callable[[Tensors], object]) -> bytes:
    tensors = load(model()[0])
    change(tensors)
    return save(tensors)


def _shaped(**changes: Any) -> dict[str, Any]:
    inside = model()[1]["model"]
    return {"model": inside | {"architecture": inside["architecture"] | changes}}


def handmade() -> list[Hostile]:
    """Return the cases made by hand."""
    weights = model()[0]
    first = "network." + next(name for name in load(weights) if name.startswith("network.")).removeprefix("network.")
    size = int.from_bytes(weights[:8], "little")
    cases: list[tuple[Any, ...]] = [
        ("valid", weights, None, "accepted"),
        ("truncated", weights[:-100], None, "refused", "truncated"),
        ("another's hash", weights, {"weights_sha256": "0" * 64}, "refused", "SHA-256"),
        ("a pickle", pickle.dumps({"a": 1}), None, "refused", "safetensors"),
        ("a header of 2^60 bytes", struct.pack("<Q", 2**60) + weights[8:], None, "refused"),
        ("a header of 2^64 - 1 bytes", struct.pack("<Q", 2**64 - 1) + weights[8:], None, "refused"),
        ("a header nested 100,000 deep", struct.pack("<Q", 200_000) + b"[" * 100_000 + b"]" * 100_000, None, "refused"),
        ("a header alone", weights[: 8 + size], None, "refused"),
        ("weights of NaN", _with(lambda t: t[first].fill_(float("nan"))), None, "refused", "not finite"),
        ("weights of infinity", _with(lambda t: t[first].fill_(float("inf"))), None, "refused", "not finite"),
        ("a standard deviation of 0", _with(lambda t: t["normaliser.std"].zero_()), None, "refused", "std"),
        ("a standard deviation of -1", _with(lambda t: t["normaliser.std"].fill_(-1)), None, "refused", "std"),
        ("a mean of 1e30", _with(lambda t: t["normaliser.mean"].fill_(1e30)), None, "either"),
        ("whole numbers", _with(lambda t: t.update({first: t[first].int()})), None, "refused"),
        ("no tensors", save({}), None, "refused", "shape"),
        ("a tensor of 10^6 names", _with(lambda t: t.update({f"x{i}": torch.zeros(1) for i in range(10_000)})), None, "refused"),
        ("a pipe", Pipe(), None, "refused"),
        ("a device", Link("/dev/zero"), None, "refused"),
        ("a config that is a pipe", weights, Pipe(), "refused"),
        ("a config of NaN", weights, as_content(model()[1] | {"weights_sha256": float("nan")}), "refused"),
        ("a config of a list", weights, b"[]", "refused"),
        ("a config nested 100,000 deep", weights, b"[" * 100_000, "refused"),
        ("a name of control characters", weights, {"model": model()[1]["model"] | {"hand": CONTROL}}, "either"),
        *((f"{key} {value!r:.30}", weights, _shaped(**{key: value}), "refused") for key, value in (
            ("depth", 100_000), ("depth", 0), ("depth", -1), ("depth", 1.5), ("depth", True), ("depth", None), ("width", 0), ("width", 10**9),
            ("width", 17), ("num_heads", 0), ("num_heads", 3), ("mlp_ratio", 0), ("feature_width", 0), ("encoder_widths", []),
            ("encoder_widths", [0]), ("encoder_widths", [10**9]), ("encoder_widths", [16] * 10_000), ("encoder_widths", "ab"),
            ("encoder_widths", 5), ("num_train_timesteps", 10**12), ("num_train_timesteps", 1), ("clean_limit", -1),
            ("clean_limit", "6"), ("clean_limit", None), ("schedule", "x"), ("schedule", []), ("zero_terminal_snr", "yes"),
            ("token_layout", {}), ("prediction_type", None), ("unknown", 1))),
    ]  # fmt: skip
    return [
        *(model_case(*case) for case in cases),
        state_case("valid", state(), "accepted"),
        state_case("a header of 2^60 bytes", struct.pack("<Q", 2**60) + state()[8:], "refused"),
        state_case("a pickle", pickle.dumps({"a": 1}), "refused"),
        state_case("a pipe", Pipe(), "refused"),
        state_case("truncated", state()[:-10], "refused", "truncated"),
    ]


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"model": _draw_model, "state": _draw_state}
