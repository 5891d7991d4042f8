"""The report over all entries that were judged: text, numbers, a table, a chart, and a page."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

from dexnudge.benchmark.entry import Entry
from dexnudge.benchmark.page import PAGE, first_draws, one_line, rate_charts, write_page
from dexnudge.benchmark.records import ALL, METRICS, Records, merged
from dexnudge.benchmark.tasks import TaskSet
from dexnudge.experiments.metrics import measure
from dexnudge.experiments.report import FEW, FEWEST, made_with, write_files
from dexnudge.experiments.tables import count_table, interval_chart, metric_table
from dexnudge.experiments.trial import Section

MOST_LISTED = 20  # rejected first draws in the report
MARKUP = re.compile(r"[\\`*\[\]|]|(?<![^\W_])_|_(?![^\W_])")  # of Markdown; not "_" within a word
ABOUT = (
    "% of all tasks, those without a valid answer among them; in brackets 95 % intervals by bootstrap over objects. First: "
    "the draw that the method ranks first, verified by geometry and forces. Share: of the {draws} draws that a task allows, "
    "missing ones, and those that repeat an earlier one, count as failures. Open loop, feedback: the first draw played out "
    "in physics. Seconds: median of answered tasks, as each entry says, where it says so of all."
)
RATES = {"first": "first draw verified", "feedback": "first draw in physics, with feedback"}


def write_report(
    entries: Sequence[Entry], tasks: TaskSet, found: Records, claims: Mapping[str, dict[str, Any]], out: Path
) -> str:
    """Write report.md, report.json, report.csv, rates.png and report.html into a folder; return the first.

    found: what the judge found of these entries. claims: of each, by its name, see `read_claim`.

    Raises:
        OutputError: the folder cannot be written.
    """
    suite = tasks.suite
    records = sorted(found, key=lambda record: ([*suite.families].index(record.scene), record.object))
    measured = [*measure(merged(records), METRICS), *measure(records, METRICS)]
    counts = [metric for metric in METRICS if metric.form == "counts"]
    judges = {each.name: sorted({record.judge for record in found if record.method == each.name}) for each in entries}
    processors = " and ".join(dict.fromkeys(claim["machine"]["processor"] for claim in claims.values()))
    setting = (
        f"Suite {suite.name}, version {suite.version}: {len(tasks.tasks)} tasks, hand {suite.hand}, fingerprint "
        f"`{tasks.fingerprint[:16]}`; {_judged_by(judges)}, {processors}."
    )
    about = f"{setting} {ABOUT.format(draws=suite.draws)}{FEW if len(suite.objects) < FEWEST else ''}"
    bars = {what: {row["method"]: row[name] for row in measured if row["scene"] == ALL} for name, what in RATES.items()}
    rates = metric_table(measured, [metric for metric in METRICS if metric not in counts])
    tables = {metric.header: count_table(measured, metric.name) for metric in counts}
    who = [f"{each.name}: {each.authors}; used: {each.used}; machine: {each.machine}" for each in entries]
    lists, title = _failed(records), f"Benchmark {suite.name}"
    made = [*dict.fromkeys(map(made_with, claims.values()))]
    sections = [
        Section("", about, rates),
        Section("Rates", "", chart=("rates.png", lambda: interval_chart(title, bars))),
        Section("Entries", _markdown(who)),
        *(Section(heading, "", table) for heading, table in tables.items()),
        *(Section(heading, _markdown(lines)) for heading, lines in lists.items()),
        Section("Made with", _markdown(made)),
    ]
    numbers = {"suite": asdict(suite), "fingerprint": tasks.fingerprint, "judged_by": judges, "metrics": measured}
    text = write_files(out, title, sections, numbers, measured)
    write_page(
        out / PAGE,
        title,
        about.replace("`", ""),
        {"Rates": rates, **tables},
        {"Entries": who, **lists, "Made with": made},
        pictures=f"{rate_charts(measured, RATES)}\n{first_draws(entries, tasks, records)}",
    )
    return text


def _judged_by(judges: Mapping[str, Sequence[str]]) -> str:
    """Return which versions judged; of several, which entry by which: their figures are not comparable."""
    versions = {version for each in judges.values() for version in each}
    if len(versions) <= 1:
        return f"judged by dexnudge {', '.join(versions)}"
    each = "; ".join(f"{name} by {' and '.join(found)}" for name, found in judges.items())
    return f"judged by several versions of dexnudge, which may differ ({each}), to compare judge again in a new folder"


def _failed(records: Records) -> dict[str, list[str]]:
    """Return why first draws and answers failed, under their headings; what has failed nowhere is left out."""
    each = [(f"{record.method}, {task.task}", task) for record in records for task in record.tasks]
    rejected = [f"{name}: {task.rejected}" for name, task in each if task.rejected]
    if len(rejected) > MOST_LISTED:
        rejected[MOST_LISTED:] = [f"and {len(rejected) - MOST_LISTED} more: entries/NAME/results.jsonl has all"]
    problems = [f"{name}: {task.problem}" for name, task in each if task.problem]
    lists = {"First draws that are rejected": rejected, "Answers that are missing or malformed": problems}
    return {heading: lines for heading, lines in lists.items() if lines}


def _markdown(lines: Sequence[str]) -> str:
    """Return lines as a list of Markdown that shows them: nothing in them is markup."""
    return "\n".join("- " + MARKUP.sub(r"\\\g<0>", escape(one_line(line), quote=False)) for line in lines)
