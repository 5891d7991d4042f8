"""The card of a model: `README.md` beside its weights, written from the files of the run that trained it."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dexnudge.diffusion.checkpoint import WEIGHTS_NAME, load_model, read_provenance
from dexnudge.diffusion.config import Architecture
from dexnudge.diffusion.training_config import TrainingConfig
from dexnudge.diffusion.training_run import LOG_NAME, MODEL_FOLDER, REPORTED_LEVELS
from dexnudge.diffusion.training_state import SETTINGS_BEFORE, read_header
from dexnudge.jobs.folders import replace_atomically

# settings that `dexnudge train` has no option for; a run that changed one of them is made again from Python
WITHOUT_OPTION = (
    "warmup_steps",
    "weight_decay",
    "gradient_clip",
    "ema_decay",
    "num_points",
    "snr_limit",
    "log_every",
    "mlp_ratio",
    "encoder_widths",
    "feature_width",
    "num_train_timesteps",
    "clean_limit",
)


def training_recipe(settings: dict[str, Any]) -> str:
    """A fenced block of Markdown; DATA and RUN stand for the two folders.

    settings: `asdict` of a `TrainingConfig`, and `processes`, as a model's provenance has them.
    """
    processes = settings.get("processes", 1)
    changed, shape = changed_settings(settings)
    if any(name in WITHOUT_OPTION for name in (*changed, *shape)):
        inner = ", ".join(f"{name}={value!r}" for name, value in shape.items())
        outer = [f"{name}={value!r}" for name, value in changed.items()] + (
            [f"architecture=Architecture({inner})"] * bool(shape)
        )
        lines = [
            "from dexnudge.diffusion.config import Architecture",
            "from dexnudge.diffusion.training import train",
            "from dexnudge.diffusion.training_config import TrainingConfig",
            "",
            f"train(DATA, RUN, TrainingConfig({', '.join(outer)}))" + (f"  # {processes} processes" * (processes > 1)),
        ]
        return "\n".join(["```python", *lines, "```"])
    launcher = f"torchrun --nproc-per-node {processes} -m dexnudge" if processes > 1 else "dexnudge"
    options = [f"--{name.replace('_', '-')} {value}" for name, value in {**changed, **shape}.items()]
    return "\n".join(["```", " ".join([f"{launcher} train --data DATA --out RUN", *options]), "```"])


def changed_settings(settings: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings that differ from their defaults: those of the training, and those of the architecture."""
    shape = {name: _tuples(value) for name, value in settings["architecture"].items()}
    default_shape = asdict(Architecture(prediction_type=shape["prediction_type"]))
    default_shape["prediction_type"] = Architecture().prediction_type
    defaults = {name: value for name, value in asdict(TrainingConfig()).items() if name != "architecture"}
    changed = {name: settings[name] for name, value in defaults.items() if settings.get(name, value) != value}
    return changed, {name: value for name, value in shape.items() if value != default_shape[name]}


def _tuples(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


CARD_NAME = "README.md"
CURVE_ROWS = 12  # of the learning curve, spread evenly over the run
NOT_RECORDED = "not recorded"
PURPOSE = """\
Proposes hand configurations near an object, given the object's surface, the kind of behaviour and a direction of motion.
It knows nothing of the surroundings: these come in while sampling. `--weights` of `dexnudge sample` and `dexnudge evaluate`
takes this folder."""
ERRORS = """\
Root mean square error of the clean estimate on the objects held out, averaged weights, by share of the noise steps."""
REPEAT = """\
DATA is the dataset folder, RUN a new one. The same machine and versions give the same weights, unless a run ends by time."""
LIMITS = (
    "For this hand alone: another one is refused, by the names of its joints.",
    "For objects as in the data: 2 to 60 cm, at rest on a stable face, moved in the plane.",
    "The objects held out come from the same source as the others: their errors say little about objects of another kind.",
    "The errors above are those of the estimate, no rate of success; `dexnudge evaluate --weights` measures that.",
    "Unguided samples touch and penetrate: guidance and projection belong to it, and every draw is judged afterwards.",
)


def write_model_card(run_folder: Path | str, *, made_with: dict[str, Any] | None = None) -> Path:
    """Write the card into the model folder of a training run and return its path.

    made_with: versions and machine, for a run that did not record its own. Raises CheckpointError when the run has no
    readable state or model.
    """
    run_folder = Path(run_folder)
    model = run_folder / MODEL_FOLDER
    network, _ = load_model(model)
    provenance: dict[str, Any] = read_provenance(model)
    header = read_header(run_folder)
    settings = _settings(provenance["config"], header)
    parameters = sum(parameter.numel() for parameter in network.parameters())
    validation = provenance["validation"]
    facts = [
        ("hand", f"{network.config.hand}, {len(network.config.joint_names)} joints"),
        ("parameters", f"{parameters:,}; {(model / WEIGHTS_NAME).stat().st_size / 1e6:.1f} MB"),
        ("steps", f"{provenance['step']:,}, each of {settings['groups'] * settings['rows_per_group']} configurations"),
        ("time", f"{header['minutes']:.1f} min"),
        *_made_with(provenance, made_with),
    ]
    text = [
        f"# Diffusion prior for the hand {network.config.hand}",
        PURPOSE,
        _table(("", ""), facts),
        "## Data",
        _data(provenance),
        "## Validation",
        ERRORS,
        _table(("noise", "translation [mm]", "joint angles [deg]"), _errors(validation)),
        f"Loss over all noise levels: {_number(validation.get('validation/loss'))}.",
        "## Learning curve",
        _table(("step", "training loss", "validation loss", "translation at 0.5 [mm]"), _curve(run_folder / LOG_NAME)),
        "## Settings",
        _table(("setting", "value"), _flat_rows(settings)),
        "## How to make it again",
        REPEAT,
        training_recipe(settings),
        "## Limits",
        "\n".join(f"- {limit}" for limit in LIMITS),
    ]
    with replace_atomically(model / CARD_NAME) as temporary:
        temporary.write_text("\n\n".join(text) + "\n", encoding="utf-8")
    return model / CARD_NAME


def _settings(recorded: dict[str, Any], header: dict[str, Any]) -> dict[str, Any]:
    """The run's settings; those that it did not know yet have the value that they had in effect."""
    before = {name: value for name, value in SETTINGS_BEFORE.items() if "." not in name}
    inner = {name.split(".")[1]: value for name, value in SETTINGS_BEFORE.items() if "." in name}
    settings = {**before, **recorded, "architecture": {**inner, **recorded["architecture"]}}
    if "max_minutes" not in settings and header["step"] < settings["steps"]:
        settings["max_minutes"] = round(header["minutes"], 1)  # the budget itself was not recorded; the run ended by it
    return settings


def _data(provenance: dict[str, Any]) -> str:
    held_out = provenance["held_out_objects"]
    return (
        f"{provenance.get('data', 'Dataset')}, {provenance['configurations']:,} configurations. "
        f"Fingerprint: `{provenance['dataset'][:16]}`. Trained on {provenance['objects']} objects; "
        f"{len(held_out)} are held out by a hash of their names: {', '.join(held_out) or 'none'}."
    )


def _made_with(provenance: dict[str, Any], given: dict[str, Any] | None) -> list[tuple[str, str]]:
    recorded = provenance.get("made_with") or given or {}
    return [(name, str(value)) for name, value in recorded.items()] or [("versions and machine", NOT_RECORDED)]


def _errors(validation: dict[str, float]) -> list[tuple[str, ...]]:
    kinds = ("translation_mm", "joints_deg")
    return [
        (f"{level:g}", *(_number(validation.get(f"validation/{kind}_at_{level}")) for kind in kinds))
        for level in REPORTED_LEVELS
    ]


def _curve(path: Path) -> list[tuple[str, ...]]:
    """One row for each of some validations, with the training loss that was last reported before it."""
    rows: list[tuple[str, ...]] = []
    loss = None
    for line in path.read_text(encoding="utf-8").splitlines():
        event = json.loads(line)
        loss = event.get("train/loss", loss)
        if "validation/loss" in event:
            translation = event.get("validation/translation_mm_at_0.5")
            rows.append((f"{event['step']:,}", _number(loss), _number(event["validation/loss"]), _number(translation)))
    stride = max(1, -(-len(rows) // CURVE_ROWS))
    return rows[::-1][::stride][::-1]  # counted from the end, so that the last one is there


def _flat_rows(settings: dict[str, Any]) -> list[tuple[str, str]]:
    inner = settings["architecture"]
    outer = {name: value for name, value in settings.items() if name != "architecture"}
    return [(f"`{name}`", str(value)) for name, value in {**outer, **inner}.items()]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines)
