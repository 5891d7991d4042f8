"""The card of a model: `README.md` beside its weights, written from the files of the run that trained it."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dexnudge.dataset.document import Document, Section, Table
from dexnudge.diffusion.checkpoint import (
    LOG_NAME,
    MODEL_FOLDER,
    WEIGHTS_NAME,
    load_model,
    read_provenance,
    read_state_header,
)
from dexnudge.diffusion.config import DEFAULT_STEPS, Architecture, TrainingConfig
from dexnudge.diffusion.objective import REPORTED_LEVELS
from dexnudge.jobs.atomic_files import replace_atomically

CARD_NAME = "README.md"
CURVE_ROWS = 12  # of the learning curve, spread evenly over the run
PURPOSE = """\
Proposes hand configurations near an object, given the object's surface, the kind of behaviour and a direction of motion. \
It knows nothing of the surroundings: these come in while sampling. \
`--weights` of `dexnudge sample` and `dexnudge evaluate` takes this folder."""
ERRORS = """\
Root mean square error of the clean estimate on the objects held out, averaged weights, by share of the noise steps."""
ERROR_KINDS = {"translation_mm": "translation [mm]", "joints_deg": "joint angles [deg]", "slides_mm": "slides [mm]"}
REPEAT = """\
DATA is the dataset folder, RUN a new one. The same machine and versions give the same weights, unless a run ends by time."""
LIMITS = """\
- For this hand alone: another one is refused, by the names of its joints.
- For objects as in the data: 2 to 60 cm, at rest on a stable face, moved in the plane.
- The objects held out come from the same source as the others: their errors say little about objects of another kind.
- The errors above are those of the estimate, no rate of success; `dexnudge evaluate --weights` measures that.
- Unguided samples touch and penetrate: guidance and projection belong to it, and every draw is verified afterwards."""


def training_command(settings: dict[str, Any]) -> str:
    """Return the command that trains with these settings; DATA and RUN stand for the two folders.

    settings: `asdict` of a `TrainingConfig`, and `processes`, as a model's provenance has them.
    """
    processes = settings.get("processes", 1)
    launcher = f"torchrun --nproc-per-node {processes} -m dexnudge" if processes > 1 else "dexnudge"
    shape, default_shape = settings["architecture"], asdict(Architecture())
    default_shape["zero_terminal_snr"] = shape["prediction_type"] != "epsilon"
    defaults = {**asdict(TrainingConfig()), "steps": DEFAULT_STEPS, **default_shape}
    changed = {
        name: value
        for name, value in {**settings, **shape}.items()
        if name in defaults and name != "architecture" and _argument(value) != _argument(defaults[name])
    }
    options = [f"--{name.replace('_', '-')} {_argument(value)}" for name, value in changed.items()]
    return " ".join([f"{launcher} train --data DATA --out RUN", *options])


def _argument(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def write_model_card(run_folder: Path | str) -> Path:
    """Write the card into the model folder of a training run and return its path.

    Raises:
        CheckpointError: the run has no readable state or model.
    """
    run_folder = Path(run_folder)
    model = run_folder / MODEL_FOLDER
    network, _ = load_model(model)
    provenance = read_provenance(model)
    header = read_state_header(run_folder)
    settings, validation, held_out = (provenance[key] for key in ("config", "validation", "held_out_objects"))
    parameters = sum(parameter.numel() for parameter in network.parameters())
    facts = {
        "hand": f"{network.config.hand}, {len(network.config.joint_names)} joints",
        "parameters": f"{parameters:,}; {(model / WEIGHTS_NAME).stat().st_size / 1e6:.1f} MB",
        "steps": f"{provenance['step']:,}, each of {settings['groups'] * settings['rows_per_group']} configurations",
        "time": f"{header['minutes']:.1f} min",
        **provenance["made_with"],
    }
    kinds = dict(ERROR_KINDS)
    for kind in ("joints_deg", "slides_mm"):  # where the hand has such joints
        if validation and f"validation/{kind}_at_{REPORTED_LEVELS[0]}" not in validation:
            del kinds[kind]
    errors = [
        (
            f"{level:g}",
            *(_number(validation.get(f"validation/{kind}_at_{level}")) for kind in kinds),
        )
        for level in REPORTED_LEVELS
    ]
    data = (
        f"{provenance['data']}, {provenance['configurations']:,} configurations. "
        f"Fingerprint: `{provenance['dataset'][:16]}`. Trained on {provenance['objects']} objects; "
        f"{len(held_out)} are held out by a hash of their names: {', '.join(held_out) or 'none'}."
    )
    flat = {**settings, **settings["architecture"]}
    card = Document(
        f"Diffusion prior for the hand {network.config.hand}",
        PURPOSE,
        (
            Section("Facts", (_table(("", ""), facts.items()),)),
            Section("Data", (data,)),
            Section(
                "Validation",
                (
                    ERRORS,
                    _table(("noise", *kinds.values()), errors),
                    f"Loss over all noise levels: {_number(validation.get('validation/loss'))}.",
                ),
            ),
            Section("Learning curve", (_curve(run_folder / LOG_NAME),)),
            Section(
                "Settings",
                (_table(("setting", "value"), [(f"`{k}`", v) for k, v in flat.items() if k != "architecture"]),),
            ),
            Section("How to make it again", (REPEAT, f"```\n{training_command(settings)}\n```")),
            Section("Limits", (LIMITS,)),
        ),
    )
    with replace_atomically(model / CARD_NAME) as temporary:
        temporary.write_text(card.markdown(), encoding="utf-8")
    return model / CARD_NAME


def _curve(path: Path) -> Table:
    """One row for each of some validations, with the training loss that was last reported before it."""
    rows = []
    loss = None
    for line in path.read_text(encoding="utf-8").splitlines():
        event = json.loads(line)
        loss = event.get("train/loss", loss)
        if "validation/loss" in event:
            numbers = (loss, event["validation/loss"], event.get("validation/translation_mm_at_0.5"))
            rows.append((f"{event['step']:,}", *map(_number, numbers)))
    stride = max(1, -(-len(rows) // CURVE_ROWS))
    chosen = rows[::-1][::stride][::-1]  # counted from the end, so that the last one is there
    return _table(("step", "training loss", "validation loss", "translation at 0.5 [mm]"), chosen)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _table(header: tuple[str, ...], rows: Iterable[Sequence[Any]]) -> Table:
    return Table("", header, tuple(tuple(map(str, row)) for row in rows))
