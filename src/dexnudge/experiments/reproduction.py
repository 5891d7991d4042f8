"""The tables of the paper, and the rows that they lack, as a list of experiments: one resumable run and its report.

Each part of the run is an experiment in a folder of its own, with its own report.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError, UnknownNameError
from dexnudge.experiments.comparisons import ABOUT_PAPER, MAIN, STEERED_NOISE, paper_table
from dexnudge.experiments.config import ExperimentConfig, trial_keys
from dexnudge.experiments.failures import failure_sections, worst_cases
from dexnudge.experiments.metrics import Measured, measure, named
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.report import made_with, rates_chart, setting, write_files, write_report
from dexnudge.experiments.run import TrialRunner
from dexnudge.experiments.sampling_records import METRICS, SamplingRecord
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.experiments.tables import method_table, metric_table
from dexnudge.experiments.trial import Section
from dexnudge.jobs.folders import claim_folder, owned_folder, read_claim
from dexnudge.sampling.methods import METHODS

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

            def show(_: Any, record: TrialRecord, done: int, __: int, before: int = sum(sizes[:number])) -> None:
                if on_record:
                    on_record(record, before + done, sum(sizes))

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
