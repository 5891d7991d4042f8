"""The command, or the Python call, that makes a recorded training run again."""

from dataclasses import asdict
from typing import Any

from dexnudge.diffusion.config import Architecture
from dexnudge.diffusion.training_config import TrainingConfig

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
