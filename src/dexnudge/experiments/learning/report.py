"""The report on a learned hand: what was spent, what came of it, what was cut; every number from the stages' files."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dexnudge.dataset.manifest import Manifest, read_manifest
from dexnudge.diffusion.checkpoint import read_state_header
from dexnudge.diffusion.model_card import CARD_NAME
from dexnudge.experiments.learning.plan import METHODS, LearningPlan
from dexnudge.experiments.metrics import measure, named
from dexnudge.experiments.report import FEW, FEWEST, REPORT, made_with, write_files
from dexnudge.experiments.run import read_run
from dexnudge.experiments.sampling_records import METRICS
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.experiments.tables import Table, count_table, metric_table
from dexnudge.experiments.trial import Section
from dexnudge.hands.hand import Hand
from dexnudge.jobs.atomic_files import replace_atomically
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
USE = """\
```
dexnudge sample phone --scene table --hand {}
```

The weights beside the description are found by themselves."""
MORE = ("- [data](data/README.md): what the dataset holds", "- [model](../weights/README.md): how it was trained")
EVERY_FIGURE = f"- [{{0}}](evaluation/{{0}}/{REPORT}.md): every figure of the evaluation"


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
    manifest, header = read_manifest(learning / "data"), read_state_header(learning / "training")
    training = {name: header[name] for name in ("step", "minutes", "validation")}
    runs = [read_run(SamplingTrial(), learning / "evaluation" / scene) for scene in scenes]
    claim, records = runs[0][0], [record for _, found in runs for record in found]
    records.sort(key=lambda each: (scenes.index(each.scene), METHODS.index(each.method), each.object))
    measured = measure(records, METRICS)
    single = {row["method"]: row["single"].percent() for row in measured if row["scene"] == "table"}
    learned, without = (single[method] for method in METHODS)
    headline = f"On the table {learned} % of single draws succeed, without learning {without} %."
    few = FEW if plan.trial_objects < FEWEST else ""
    about = (
        f"{plan.trial_objects} objects of builtin:test, none of which was learned from, {plan.draws} draws each, "
        f"seed {plan.seed}. "
    )
    late = [scene for scene in plan.scenes if scene not in scenes]
    left_out = [*plan.cuts, *([f"evaluation in the scenes {', '.join(late)}: no time was left"] if late else [])]
    success, picture = f"{about}{ABOUT}{few}", _picture(folder, hand, plan)
    sections = [
        Section("", f"{hand.num_joints} joints, {len(hand.fingertips)} digits. {headline}"),
        Section("Success", success, metric_table(measured, SHOWN)),
        Section("Time", "", _time_table(plan, seconds)),
        _data(manifest),
        Section("Training", _training_text(training, plan)),
        Section("Why draws were rejected", "", count_table(measured, "rejected")),
        Section("What the minutes did not suffice for", _list(left_out)),
        Section("Use it", USE.format(folder)),
        Section("Pictures", f"![The best draw for a {SHOWN_OBJECT} on the table]({PICTURE})\n\n{picture}"),
        Section("More", "\n".join([*MORE, *(EVERY_FIGURE.format(scene) for scene in scenes)])),
        Section("Made with", made_with(claim)),
    ]
    numbers = {
        "hand": hand.name,
        "plan": asdict(plan),
        "seconds": dict(seconds),
        "data": manifest.counts,
        "training": training,
        "metrics": measured,
        "left_out": left_out,
        **{name: claim[name] for name in ("versions", "machine")},
    }
    text = write_files(learning, f"Learned: {hand.name}", sections, numbers, measured)
    card = folder / WEIGHTS_FOLDER / CARD_NAME
    before = card.read_text(encoding="utf-8").partition(CARD_HEADING)[0]
    with replace_atomically(card) as temporary:
        temporary.write_text(
            f"{before}{CARD_HEADING}{success}\n\n{metric_table(measured, SHOWN).markdown()}\n", encoding="utf-8"
        )
    return text, any(row["any"].value > 0 for row in measured if row["method"] == METHODS[0])


def _time_table(plan: LearningPlan, seconds: Mapping[str, float]) -> Table:
    stages = ("measuring", "data", "training", "evaluation")
    rows = [[each, f"{getattr(plan, each) / 60:.1f}", f"{seconds.get(each, 0.0) / 60:.1f}"] for each in stages]
    total = sum(seconds.get(each, 0.0) for each in stages) / 60
    return Table(
        ["stage", "planned [min]", "taken [min]"], [*rows, ["total", f"{plan.minutes:g}", f"{total:.1f}"]], labels=1
    )


def _data(manifest: Manifest) -> Section:
    counts: Mapping[str, Any] = manifest.counts
    failed = "".join(f"\n- {name} failed: {why}" for name, why in sorted(manifest.failed_objects.items()))
    text = f"{len(manifest.objects)} objects of builtin:train. attempted = kept + rejected + failed.{failed}"
    reasons = list(dict.fromkeys(reason for count in counts.values() for reason in count["rejected"]))
    rows = [
        [name, each["attempted"], each["kept"], *(each["rejected"].get(why, 0) for why in reasons), each["failed"]]
        for name, each in counts.items()
        if each["attempted"]
    ]
    return Section("Data", text, Table(["behaviour", "attempted", "kept", *reasons, "failed"], rows, labels=1))


def _training_text(training: Mapping[str, Any], plan: LearningPlan) -> str:
    step, found = training["step"], training["validation"]
    why = "" if step >= plan.steps else ": the machine was slower than measured, and the time was up"
    validated = [
        f"- {name.removeprefix('validation/').replace('_', ' ')}: {value:.4g}" for name, value in found.items()
    ]
    errors = "\n\nOn the objects held out:\n\n" + "\n".join(validated) if validated else ""
    return f"{step:,} of {plan.steps:,} planned steps in {training['minutes']:.1f} min{why}.{errors}"


def _list(lines: Sequence[str]) -> str:
    if not lines:
        return "Nothing: more minutes would buy little."
    return "\n".join(f"- {line}" for line in lines) + "\n\nMore minutes buy these, from the first to the last."


def _picture(folder: Path, hand: Hand, plan: LearningPlan) -> str:
    """Draw for one object, keep the picture of the best draw, and say what it shows."""
    samples = Sampler(hand).sample(build_scene("table", SHOWN_OBJECT, seed=plan.seed), num=plan.draws, seed=plan.seed)
    samples.picture(folder / "learning" / PICTURE)
    return f"{samples.num_verified} of these {len(samples)} draws succeed; shown is the top-ranked one."
