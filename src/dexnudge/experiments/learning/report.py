"""The report on a learned hand: what was spent, what came of it, what was cut; every number from the stages' files."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dexnudge.dataset.manifest import read_manifest
from dexnudge.diffusion.checkpoint import read_state_header
from dexnudge.diffusion.model_card import CARD_NAME
from dexnudge.experiments.learning.plan import METHODS, LearningPlan
from dexnudge.experiments.metrics import Measured, measure, named
from dexnudge.experiments.report import FEW, FEWEST, REPORT, made_with, write_files
from dexnudge.experiments.run import read_run
from dexnudge.experiments.sampling_records import METRICS
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.experiments.tables import Table, count_table, metric_table
from dexnudge.experiments.trial import Section
from dexnudge.hands.hand import Hand
from dexnudge.jobs.folders import replace_atomically
from dexnudge.sampling.sampler import WEIGHTS_FOLDER, Sampler
from dexnudge.scenes.families import build_scene

SHOWN = named(METRICS, "objects", "failed", "draws", "single", "top", "any", "verified_per_second")
PICTURE, SHOWN_OBJECT = "best.png", "phone"  # on the table
ABOUT = (
    "Rates in % of what was attempted, 95 % intervals by bootstrap over objects in brackets. Single: of all draws. "
    "Top-ranked: the best verified draw of an object, which a robot would use. steered_noise draws with the learned model; "
    "random_start_projection draws for the same objects and scenes without it."
)
CARD_HEADING = "\n## Success\n\n"


def write_learning_report(
    folder: Path, hand: Hand, plan: LearningPlan, seconds: Mapping[str, float], scenes: Sequence[str]
) -> tuple[str, bool]:
    """Write report.md, .json and .csv into HAND/learning, add the success to the card of the weights.

    Return the text, and whether any draw with the learned weights succeeded.

    seconds: of each stage. scenes: those that were evaluated.

    Raises:
        InputError, CheckpointError, DatasetError: a stage's files are missing or damaged.
        OutputError: the folder cannot be written.
    """
    learning = folder / "learning"
    stages = _Stages.read(learning, scenes)
    measured = measure(stages.records, METRICS)
    few = FEW if plan.trial_objects < FEWEST else ""
    about = (
        f"{plan.trial_objects} objects of builtin:test, none of which was learned from, {plan.draws} draws each, "
        f"seed {plan.seed}. "
    )
    left_out = [
        f"evaluation in the scenes {', '.join(late)}: no time was left" for late in [_late(plan, scenes)] if late
    ]
    picture = _picture(folder, hand, plan)
    sections = [
        Section("", f"{hand.num_joints} joints, {len(hand.fingertips)} digits. {_headline(measured)}"),
        Section("Success", f"{about}{ABOUT}{few}", metric_table(measured, SHOWN)),
        Section("Time", "", _time_table(plan, seconds)),
        Section("Data", _data_text(stages), _data_table(stages)),
        Section("Training", _training_text(stages, plan)),
        Section("Why draws were rejected", "", count_table(measured, "rejected")),
        Section("What the minutes did not suffice for", _list([*plan.cuts, *left_out])),
        Section("Use it", _use(folder)),
        Section("Pictures", f"![The best draw for a {SHOWN_OBJECT} on the table]({PICTURE})\n\n{picture}"),
        Section("More", _more(scenes)),
        Section("Made with", made_with(stages.claim)),
    ]
    numbers = {
        "hand": hand.name,
        "plan": asdict(plan),
        "seconds": dict(seconds),
        "data": stages.counts,
        "training": stages.training,
        "metrics": measured,
        "left_out": [*plan.cuts, *left_out],
        **{name: stages.claim[name] for name in ("versions", "machine")},
    }
    text = write_files(learning, f"Learned: {hand.name}", sections, numbers, measured)
    _add_to_card(
        folder / WEIGHTS_FOLDER / CARD_NAME, f"{about}{ABOUT}{few}\n\n{metric_table(measured, SHOWN).markdown()}\n"
    )
    return text, any(row["any"].value > 0 for row in measured if row["method"] == METHODS[0])


@dataclass(frozen=True)
class _Stages:
    """What the stages wrote. counts: of the data, behaviour -> totals. claim: of the first scene's evaluation."""

    objects: int
    failed_objects: Mapping[str, str]
    counts: Mapping[str, Any]
    training: Mapping[str, Any]
    records: Sequence[Any]
    claim: dict[str, Any]

    @classmethod
    def read(cls, learning: Path, scenes: Sequence[str]) -> "_Stages":
        manifest, header = read_manifest(learning / "data"), read_state_header(learning / "training")
        runs = [read_run(SamplingTrial(), learning / "evaluation" / scene) for scene in scenes]
        return cls(
            objects=len(manifest.objects),
            failed_objects=manifest.failed_objects,
            counts=manifest.counts,
            training={name: header[name] for name in ("step", "minutes", "validation")},
            records=[record for _, records in runs for record in sorted(records, key=_place)],
            claim=runs[0][0],
        )


def _place(record: Any) -> tuple[int, str]:
    return METHODS.index(record.method), record.object


def _headline(measured: Sequence[Measured]) -> str:
    single = {row["method"]: row["single"] for row in measured if row["scene"] == "table"}
    learned, without = (single[method] for method in METHODS)
    return f"On the table {learned.percent()} % of single draws succeed, without learning {without.percent()} %."


def _time_table(plan: LearningPlan, seconds: Mapping[str, float]) -> Table:
    stages = ("measuring", "data", "training", "evaluation")
    rows = [[each, f"{getattr(plan, each) / 60:.1f}", f"{seconds.get(each, 0.0) / 60:.1f}"] for each in stages]
    total = sum(seconds.get(each, 0.0) for each in stages) / 60
    return Table(
        ["stage", "planned [min]", "taken [min]"], [*rows, ["total", f"{plan.minutes:g}", f"{total:.1f}"]], labels=1
    )


def _data_text(stages: _Stages) -> str:
    failed = "".join(f"\n- {name} failed: {why}" for name, why in sorted(stages.failed_objects.items()))
    return f"{stages.objects} objects of builtin:train. attempted = kept + rejected + failed.{failed}"


def _data_table(stages: _Stages) -> Table:
    reasons = list(dict.fromkeys(reason for count in stages.counts.values() for reason in count["rejected"]))
    rows = [
        [
            name,
            count["attempted"],
            count["kept"],
            *(count["rejected"].get(reason, 0) for reason in reasons),
            count["failed"],
        ]
        for name, count in stages.counts.items()
        if count["attempted"]
    ]
    return Table(["behaviour", "attempted", "kept", *reasons, "failed"], rows, labels=1)


def _training_text(stages: _Stages, plan: LearningPlan) -> str:
    step, found = stages.training["step"], stages.training["validation"]
    why = "" if step >= plan.steps else ": the machine was slower than measured, and the time was up"
    validated = [
        f"- {name.removeprefix('validation/').replace('_', ' ')}: {value:.4g}" for name, value in found.items()
    ]
    errors = "\n\nOn the objects held out:\n\n" + "\n".join(validated) if validated else ""
    return f"{step:,} of {plan.steps:,} planned steps in {stages.training['minutes']:.1f} min{why}.{errors}"


def _late(plan: LearningPlan, scenes: Sequence[str]) -> list[str]:
    return [scene for scene in plan.scenes if scene not in scenes]


def _list(lines: Sequence[str]) -> str:
    if not lines:
        return "Nothing: more minutes would buy little."
    return "\n".join(f"- {line}" for line in lines) + "\n\nMore minutes buy these, from the first to the last."


def _use(folder: Path) -> str:
    command = f"dexnudge sample phone --scene table --hand {folder}"
    return f"```\n{command}\n```\n\nThe weights beside the description are found by themselves."


def _picture(folder: Path, hand: Hand, plan: LearningPlan) -> str:
    """Draw for one object, keep the picture of the best draw, and say what it shows."""
    samples = Sampler(hand).sample(build_scene("table", SHOWN_OBJECT, seed=plan.seed), num=plan.draws, seed=plan.seed)
    samples.picture(folder / "learning" / PICTURE)
    return f"{samples.num_verified} of these {len(samples)} draws succeed; shown is the top-ranked one."


def _more(scenes: Sequence[str]) -> str:
    return "\n".join(
        [
            "- [data](data/README.md): what the dataset holds",
            "- [model](../weights/README.md): how it was trained",
            *(f"- [{scene}](evaluation/{scene}/{REPORT}.md): every figure of the evaluation" for scene in scenes),
        ]
    )


def _add_to_card(card: Path, text: str) -> None:
    before = card.read_text(encoding="utf-8").partition(CARD_HEADING)[0]
    with replace_atomically(card) as temporary:
        temporary.write_text(before + CARD_HEADING + text, encoding="utf-8")
