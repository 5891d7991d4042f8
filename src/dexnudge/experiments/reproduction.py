"""The tables of the paper, and the rows that they lack, as a list of experiments: one resumable run and its report.

Each part of the run is an experiment in a folder of its own, with its own report.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.errors import DexnudgeError, InputError, UnknownNameError, writing
from dexnudge.experiments.comparisons import ABOUT_PAPER, MAIN, STEERED_NOISE, paper_table
from dexnudge.experiments.config import ExperimentConfig, trial_keys
from dexnudge.experiments.metrics import Measured, measure, named
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.report import made_with, rates_chart, setting, write_files, write_report
from dexnudge.experiments.run import TrialRunner
from dexnudge.experiments.sampling_records import METRICS, Records, SamplingRecord
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.experiments.tables import Table, method_table, metric_table
from dexnudge.experiments.trial import Section, TrialSampler
from dexnudge.jobs.claims import claim_folder, read_claim
from dexnudge.jobs.folders import owned_folder
from dexnudge.sampling.methods import METHODS
from dexnudge.verification.criteria import PENETRATION_LIMIT, SUCCESS_MARGIN

MOST_CASES = 3
SIZE = (720, 540)  # pixels; several stand on one page
ABOUT = (
    "Where the smallest share of draws is verified, one case from each scene first. In the pictures: yellow, "
    "where hand and object touch; green, the motion; the grey box is the forearm."
)


Case = tuple[ExperimentConfig, SamplingRecord]
"""An object and scene in which many draws of a method fail: the experiment, and the record."""


def worst_cases(experiments: Sequence[tuple[ExperimentConfig, Records]], method: str) -> list[Case]:
    """Return the records of a method with the smallest share of verified draws, worst first; at most `MOST_CASES`.

    No two are from the same scene as long as there are others. Neither a record without a rejected draw is taken nor that
    of a failed object, which has no draws.
    """
    found = [
        (config, record)
        for config, records in experiments
        for record in records
        if record.method == method and not all(record.success)
    ]
    found.sort(key=lambda case: case[1].verified / case[1].num)
    first_of_scene: dict[str, Case] = {}
    for case in found:
        first_of_scene.setdefault(case[1].scene, case)
    chosen = list(first_of_scene.values())
    return (chosen + [case for case in found if case not in chosen])[:MOST_CASES]


def failure_sections(cases: Sequence[Case], folder: Path) -> list[Section]:
    """Draw every case again and return its section; the pictures failure-1.png and on go into `folder`.

    Raises:
        OutputError: a picture cannot be written.
    """
    if not cases:
        return [Section("Failures", "No draw was rejected.")]
    with writing(f"the pictures into {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    sections = [Section("Worst cases", ABOUT)]
    for number, (config, record) in enumerate(cases, start=1):
        path, share = folder / f"failure-{number}.png", f"{record.verified} of {record.num} draws"
        text = picture_rejected(config, record, path)
        title = f"{record.object}, {record.scene}: {share} of {record.method}"
        reasons = Table(["reason", "draws"], list(record.rejected.items()), labels=1)
        picture = f"{text}\n\n![A rejected draw]({folder.name}/{path.name})" if text else ""
        sections.append(Section(title, picture, reasons))
    return sections


def picture_rejected(config: ExperimentConfig, record: SamplingRecord, path: Path) -> str:
    """Draw a case again, write the picture of its best ranked draw with the most frequent reason, and describe it.

    Returns "" where the object cannot be read any more, or where other versions of what draws leave nothing rejected.
    """
    from dexnudge.viewer.picture import render_png
    from dexnudge.viewer.visual_scene import visual_scenes

    try:
        samples = TrialSampler(config).draw(record.key)
    except DexnudgeError:
        return ""  # the record stays as it was counted; only its picture is missing
    if samples.num_verified == len(samples):
        return ""
    reason = next(iter(samples.rejections()))
    rejected = samples[samples.reasons.index(reason)]
    q = rejected.q[None].astype(np.float64)
    shown = visual_scenes(rejected.scene, rejected.hand, q, contacts=[rejected.contacts.points])
    render_png(shown[0], path, size=SIZE)
    depths = ", ".join(
        f"{1e3 * rejected.values[f'penetration_{name}']:.2f} mm in {where}"
        for name, where in (("environment", "surroundings"), ("object", "object"), ("self", "hand itself"))
    )
    return (
        f"A rejected draw, {reason}: {samples.verdicts.sentences.get(reason, reason)}. Depth {depths}, "
        f"{1e3 * PENETRATION_LIMIT:g} mm is allowed; links in contact: {', '.join(rejected.contact_links) or 'none'}; "
        f"force margin {rejected.force_margin:.2f}, {SUCCESS_MARGIN:g} is needed."
    )


FILE = "reproduction.json"
FORMAT_VERSION = 3
PICTURES = "pictures"  # folder of failures
TABLES = (*MAIN, "guidance_only", "grasp_projection", "paper", "paper_guidance_only")  # Tables I and II compare these
RULES = ("best_of_32", "unguided_projection")  # choice without guidance, and neither
FURTHER = ("resampled", "coarse_hands", "clean_descent", "spherical", "clean_gradient", "unguided")
FROM_DATA = "nearest_pose"
QUICK_WITHOUT_BASE = (*MAIN, "guidance_only", "grasp_projection")
WITH_BASE, WITHOUT_BASE, GRASPS_ONLY = "with_base", "without_base", "grasps_only"
PREDICTIONS, HARD, GENERALISATION = "predictions", "hard", "generalisation"
PARTS = (WITH_BASE, WITHOUT_BASE, GRASPS_ONLY, PREDICTIONS, HARD, GENERALISATION)
QUICK_PARTS = (WITH_BASE, WITHOUT_BASE, GRASPS_ONLY, PREDICTIONS)
OWN_PARTS = (WITH_BASE, HARD, GENERALISATION)  # the forearm included, with the run's own weights
HARD_SCENES = ("slot", "deep", "corner", "clutter")
NEW_SCENES = ("drawer", "ramp", "stack")  # on which nothing was tuned
QUICK_NUM, FULL_NUM = 16, 32
QUICK_OBJECTS = 16  # about 25 s of one core for the trials of an object and its scenes: 4 minutes on two cores
SHOWN = named(METRICS, "single", "single_robust", "top", "top_robust", "verified_per_second")


@dataclass(frozen=True, kw_only=True)
class ReproductionConfig:
    """What is reproduced.

    Attributes:
        common: objects, draws, seed, hand, weights, data of all parts, and the scenes of all but `HARD` and
            `GENERALISATION`, which have their own. Without `data`, `nearest_pose` is left out, and the report says so.
        grasp_weights: folder of a model that was trained on grasps only; None leaves that part out.
        prediction_weights: name -> folder of a model; each is evaluated like `weights`. Empty leaves that part out.
        parts: names in `PARTS`; None for all, with `quick` for `QUICK_PARTS`.
        methods: only these of each part's; None for all.
        quick: fewer methods and parts.
    """

    common: ExperimentConfig
    grasp_weights: str | None = None
    prediction_weights: dict[str, str] = field(default_factory=dict)
    parts: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    quick: bool = False

    def as_claim(self) -> dict[str, Any]:
        """Return all options by their names, those of `common` among them."""
        own = {name: value for name, value in asdict(self).items() if name != "common"}
        return {**asdict(self.common), **own}

    @property
    def named_parts(self) -> tuple[str, ...]:
        """The parts that this run is asked for, in the order of `PARTS`."""
        chosen = self.parts if self.parts is not None else QUICK_PARTS if self.quick else PARTS
        return tuple(part for part in PARTS if part in chosen)


@dataclass(frozen=True)
class Part:
    """One experiment of the run: the folder below the run's, a heading, and what is evaluated."""

    folder: str
    title: str
    config: ExperimentConfig


def parts(config: ReproductionConfig) -> list[Part]:
    """Return the experiments of a run, in the order in which they are run; those without a method are left out.

    Raises:
        UnknownNameError: no such part. InputError: a method that no part of this run has, or no part at all.
    """
    for name in config.named_parts if config.parts is None else config.parts:
        if name not in PARTS:
            raise UnknownNameError(f"unknown part {name!r}; expected some of {', '.join(PARTS)}")
    for option, given, needs in (
        ("grasp_weights", config.grasp_weights, (GRASPS_ONLY,)),
        ("prediction_weights", config.prediction_weights, (PREDICTIONS,)),
        ("data", config.common.data, (WITH_BASE,)),
    ):
        if given and not {*needs} & {*config.named_parts}:
            raise InputError(
                f"`{option}` is given without the part {needs[0]}, which alone uses it; expected both; add {needs[0]} to "
                "`parts`, or leave it out"
            )
    every = _all_parts(config)
    offered = list(dict.fromkeys(method for part in every for method in part.config.methods))
    for method in config.methods or ():
        if method not in offered:
            raise InputError(
                f"no part of this run has the method {method!r}; expected some of {', '.join(offered)}; "
                f"{FROM_DATA} needs `data`"
            )
    found = []
    for part in every:
        methods = tuple(each for each in part.config.methods if config.methods is None or each in config.methods)
        data = config.common.data if FROM_DATA in methods else None
        if methods:
            found.append(replace(part, config=replace(part.config, methods=methods, data=data)))
    if not found:
        raise InputError(
            f"nothing is left of the parts {', '.join(config.named_parts)}; expected a part that has what it needs: "
            f"{GRASPS_ONLY} needs `grasp_weights`, {PREDICTIONS} needs `prediction_weights`"
        )
    return found


def left_out(config: ReproductionConfig) -> list[str]:
    """Return what this run does not have, and what that needs."""
    chosen = config.named_parts
    why = "by --quick" if config.parts is None else "by --parts"
    missing = [f"part {part}: left out {why}" for part in PARTS if part not in chosen]
    if not config.common.data:
        missing.append(f"{FROM_DATA}: needs a dataset, --data DIR")
    if GRASPS_ONLY in chosen and not config.grasp_weights:
        missing.append("a model trained on grasps only: needs its folder, --grasp-weights DIR")
    if PREDICTIONS in chosen and not config.prediction_weights:
        missing.append("other prediction types: need models, --prediction-weights NAME=DIR ...")
    had = {method for part in parts(config) for method in part.config.methods}
    why = "by --methods" if config.methods is not None else "by --quick" if config.quick else "by --parts"
    return missing + [f"{each}: left out {why}" for each in METHODS if each not in {*had, FROM_DATA}]


def reproduce(
    config: ReproductionConfig,
    out: Path,
    *,
    workers: int = 2,
    on_record: Callable[[TrialRecord, int, int], None] | None = None,
) -> str:
    """Run the trials that `out` does not have yet, write the reports of the run and of its parts; return the run's.

    on_record: called with (record, finished, total) for each new record, counted over all parts.

    Raises:
        InputError: `out` holds another run; a name or count in the config is not valid.
        OutputError: `out` cannot be written.
    """
    chosen = parts(config)
    sizes = [len(trial_keys(part.config)) for part in chosen]
    with owned_folder(out):
        claim_folder(out, FILE, config.as_claim(), format_version=FORMAT_VERSION, device=config.common.device)
        finished: list[tuple[Part, list[SamplingRecord]]] = []
        for number, part in enumerate(chosen):

            def show(_: Any, records: Sequence[TrialRecord], __: int, before: int = sum(sizes[:number])) -> None:
                if on_record:
                    on_record(records[-1], before + len(records), sum(sizes))

            runner = TrialRunner([SamplingTrial()], part.config, out / part.folder)
            for kind, records in runner.run(workers=workers, on_record=show):
                write_report(kind, out / part.folder)
                finished.append((part, records))
        return _write_report(config, out, finished)


def _write_report(
    config: ReproductionConfig, out: Path, finished: Sequence[tuple[Part, Sequence[SamplingRecord]]]
) -> str:
    claim, common = read_claim(out, FILE, format_version=FORMAT_VERSION), config.common
    measured = {part: measure(records, METRICS) for part, records in finished}
    by_title = {part.title.lower(): rows for part, rows in measured.items()}
    every = [{"part": part.folder, **row} for part, rows in measured.items() for row in rows]
    main = [row for row in every if row["part"] in OWN_PARTS and row["method"] in MAIN]
    cases = worst_cases([(part.config, found) for part, found in finished if part.folder in OWN_PARTS], STEERED_NOISE)
    objects = max(row["objects"] for row in every)
    failed = {each.key[:2]: each.reason for _, found in finished for each in found if each.status == "failed"}
    missing = left_out(config)
    sections = [
        Section("", f"{objects} objects, {setting(vars(common), claim)} {SamplingTrial.about}"),
        Section("Main table", "", metric_table(main, SHOWN)),
        Section("Methods", "", method_table(row["method"] for row in every)),
        Section("Table I", ABOUT_PAPER, paper_table(by_title, 1)),
        Section("Table II", "", paper_table(by_title, 2)),
        *_models(measured),
        *failure_sections(cases, out / PICTURES),
        Section("Parts", "\n".join(f"- [{part.title}]({part.folder}/report.md)" for part, _ in finished)),
        Section("Rates", "", chart=("rates.png", lambda: rates_chart(SamplingTrial(), main))),
        Section("Not in this run", "\n".join(f"- {line}" for line in missing) or "Nothing is missing."),
        Section(
            "Objects that failed", "\n".join(f"- {', '.join(key)}: {why}" for key, why in failed.items()) or "None."
        ),
        Section("Made with", made_with(claim)),
    ]
    numbers = {**claim, "left_out": missing, "metrics": every}
    return write_files(out, f"Reproduction on {Path(common.objects).name}", sections, numbers, every)


def _models(measured: dict[Part, list[Measured]]) -> list[Section]:
    """The run's own model beside others, in the scenes and with the methods of the others."""
    models = {part.title: rows for part, rows in measured.items() if part.folder.startswith(f"{PREDICTIONS}-")}
    keys = dict.fromkeys((row["scene"], row["method"]) for rows in models.values() for row in rows)
    own = [rows for part, rows in measured.items() if part.folder == WITH_BASE]  # one at most
    rows = [
        {**row, "weights": model}
        for model, rows in [*(("the run's own", rows) for rows in own), *models.items()]
        for row in rows
        if (row["scene"], row["method"]) in keys
    ]
    rows.sort(key=lambda row: list(keys).index((row["scene"], row["method"])))
    table = metric_table(rows, SHOWN, ["weights"])
    return [Section("Prediction types and other weights", "", table)] if models else []


def _all_parts(config: ReproductionConfig) -> list[Part]:
    """The parts that are asked for and have what they need, with all of their methods."""
    found = []

    def add(folder: str, title: str, methods: tuple[str, ...], **changed: Any) -> None:
        if folder.partition("-")[0] in config.named_parts:
            found.append(Part(folder, title, replace(config.common, methods=methods, **changed)))

    with_base = TABLES + RULES + (() if config.quick else FURTHER) + ((FROM_DATA,) if config.common.data else ())
    add(WITH_BASE, "With the forearm", with_base, sweep=True)
    add(WITHOUT_BASE, "Without the forearm", QUICK_WITHOUT_BASE if config.quick else TABLES, base=False)
    if config.grasp_weights:
        add(GRASPS_ONLY, "A model trained on grasps only", ("grasp_projection",), weights=config.grasp_weights)
    for label, folder in config.prediction_weights.items():
        add(f"{PREDICTIONS}-{label}", f"Weights {label}", (STEERED_NOISE,), weights=folder)
    add(HARD, "Hard scenes", MAIN, scenes=HARD_SCENES)
    add(GENERALISATION, "Scenes on which nothing was tuned", MAIN, scenes=NEW_SCENES)
    return found
