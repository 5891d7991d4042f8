"""The report of one kind of trial: report.md for people, report.json and report.csv for programs, and charts."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError, writing
from dexnudge.experiments.metrics import Measured, measure, named
from dexnudge.experiments.records import Record, TrialRecord, read_records
from dexnudge.experiments.run import read_run
from dexnudge.experiments.statistics import Estimate, as_json
from dexnudge.experiments.tables import (
    AVAILABLE,
    MISSING,
    count_table,
    csv_text,
    interval_chart,
    method_table,
    metric_table,
    save_chart,
)
from dexnudge.experiments.trial import Section, TrialKind

REPORT = "report"  # .md, .json and .csv
RATES_CHART = "rates.png"
FEWEST = 5  # objects from which an interval says something about others
FEW = f" With fewer than {FEWEST} objects an interval says little; (-) where none can be given: use more objects."


def write_report(kind: TrialKind[Record], out: Path) -> str:
    """Write the report of a kind of trial into the folder of its records and return its text.

    Raises:
        InputError: the folder holds no records of this kind, or damaged ones.
        OutputError: the folder cannot be written.
    """
    claim, records = read_run(kind, out)
    if not records:
        raise InputError(
            f"{out / kind.folder} holds no records yet; expected a folder that `dexnudge evaluate` worked on"
        )
    config = claim["config"]
    place = {name: index for index, name in enumerate([*config["scenes"], *config["methods"]])}
    records.sort(key=lambda record: (place[record.scene], place[record.method], record.object))  # not as they finished
    measured = measure(records, kind.metrics)
    counts = [metric for metric in kind.metrics if metric.form == "counts"]
    rates = [metric for metric in kind.metrics if metric not in counts]
    few = FEW if len({record.object for record in records}) < FEWEST else ""
    sections = [
        Section("", f"{setting(config, claim)} {kind.about}{few}", metric_table(measured, rates)),
        Section("Methods", "", method_table(row["method"] for row in measured)),
        Section("Rates", "", chart=(RATES_CHART, lambda: rates_chart(kind, measured))),
        *kind.sections(records),
        *(Section(metric.header, "", count_table(measured, metric.name)) for metric in counts),
        *_drawn_otherwise(kind, out, records),
        Section("Made with", made_with(claim)),
    ]
    title = f"{kind.title}: {Path(config['objects']).name}"
    numbers = {
        **claim,
        "metrics": measured,
        "sections": {each.title: each.numbers for each in sections if each.numbers},
    }
    return write_files(out / kind.folder, title, sections, numbers, measured)


def rates_chart(kind: TrialKind[Any], measured: Sequence[Measured]) -> Any:
    """Return the figure of the kind's main rate by scene and method."""
    (metric,) = named(kind.metrics, kind.rate)
    groups: dict[str, dict[str, Estimate]] = {}
    for row in measured:
        if isinstance(row[kind.rate], Estimate):
            groups.setdefault(row["scene"], {})[row["method"]] = row[kind.rate]
    return interval_chart(f"{kind.title}: {metric.header}", groups)


def write_files(
    folder: Path, title: str, sections: Sequence[Section], numbers: dict[str, Any], rows: Sequence[Measured]
) -> str:
    """Write a report's text, numbers, table and charts into a folder and return the text."""
    parts = [f"# {title}"]
    for section in sections:
        body = [section.text] if section.text else []
        body += [section.table.markdown()] if section.table else []
        if section.chart and AVAILABLE:
            name, draw = section.chart
            save_chart(draw(), folder / name)
            body.append(f"![{section.title}]({name})")
        if body:
            parts += [f"## {section.title}", *body] if section.title else body
    if not AVAILABLE:
        parts.append(MISSING)
    markdown = "\n\n".join(parts) + "\n"
    texts = {
        "md": markdown,
        "json": json.dumps(as_json(numbers), indent=2, allow_nan=False) + "\n",
        "csv": csv_text(rows),
    }
    with writing(f"the report into {folder}"):
        for suffix, text in texts.items():
            (folder / f"{REPORT}.{suffix}").write_text(text, encoding="utf-8", errors="backslashreplace")
    return markdown


def _drawn_otherwise(kind: TrialKind[Any], out: Path, records: Sequence[TrialRecord]) -> list[Section]:
    """Trials whose draws are not those of the experiment's own records, where these are there."""
    own = {record.key: record.verified for record in read_records(out, TrialRecord)} if kind.folder else {}
    number = sum(own.get(record.key, record.verified) != record.verified for record in records)
    text = f"{number} trials drew otherwise than the experiment's own, as another machine or version does."
    return [Section("Other draws", text)] if number else []


def setting(config: dict[str, Any], claim: dict[str, Any]) -> str:
    """Return with what the figures were made: draws, seed, hand, version, processor, losses that were changed."""
    base = "" if config.get("base", True) else " without base"
    text = (
        f"{config['num']} draws of each trial, seed {config['seed']}, hand {config['hand']}{base}, "
        f"dexnudge {claim['versions']['dexnudge']}, {claim['machine']['processor']}."
    )
    changed = ", ".join(f"{name} {value:g}" for name, value in (config.get("losses") or {}).items())
    return f"{text} Losses other than each method's own: {changed}." if changed else text


def made_with(claim: dict[str, Any]) -> str:
    """Return machine and versions in one line."""
    return "; ".join(f"{key} {value}" for key, value in {**claim["machine"], **claim["versions"]}.items())
