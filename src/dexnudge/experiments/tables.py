"""Figures as tables: markdown for reports, CSV for programs."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dexnudge.experiments.metrics import GroupRate, Measured, Metric
from dexnudge.experiments.statistics import Estimate


@dataclass(frozen=True)
class Table:
    """Columns under a header; the first `labels` columns are text, the others numbers."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    labels: int = 2

    def markdown(self) -> str:
        """Return the table as markdown; "None." where it has no rows."""
        if not self.rows:
            return "None."
        marks = ["---"] * self.labels + ["---:"] * (len(self.header) - self.labels)
        return "\n".join("| " + " | ".join(map(str, cells)) + " |" for cells in [self.header, marks, *self.rows])


def method_table(methods: Iterable[str]) -> Table:
    """Return what each method does, once."""
    from dexnudge.sampling.methods import find_method

    return Table(["method", "what"], [[each, find_method(each).summary] for each in dict.fromkeys(methods)])


def metric_table(measured: Sequence[Measured], metrics: Sequence[Metric], labels: Sequence[str] = ()) -> Table:
    """Return a row for each scene and method; metrics without a header, or that none of them has, are left out.

    labels: names of further labels in `measured`, between method and metrics.
    """
    columns: list[tuple[str, Metric, str | None]] = []  # header, metric, key of a metric that is a dict
    for metric in metrics:
        values = [row[metric.name] for row in measured]
        if metric.form == "counts":
            columns += [(key, metric, key) for key in dict.fromkeys(key for value in values for key in value)]
        elif metric.header and any(value is not None for value in values):
            columns.append((metric.header, metric, None))
    rows = [
        [row["scene"], row["method"], *(row[label] for label in labels)]
        + [metric.text(_entry(row[metric.name], key)) for _, metric, key in columns]
        for row in measured
        if columns
    ]
    return Table(["scene", "method", *labels, *(header for header, _, _ in columns)], rows, labels=2 + len(labels))


def group_table(name: str, found: Mapping[str, Mapping[str, GroupRate]]) -> Table:
    """Return a row for each group of the first column of `found`: column -> group -> rate."""

    def cell(group: GroupRate | None) -> str:
        return "" if group is None else f"{group.rate.percent()}, n = {group.number}"

    first = next(iter(found.values()), {})
    rows = [[label, *(cell(groups.get(label)) for groups in found.values())] for label in first]
    return Table([name, *found], rows, labels=1)


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of figures as CSV: an estimate as NAME, NAME_low, NAME_high; an entry of a dict as NAME.KEY."""
    flat = [dict(_flat(row)) for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in flat for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return text.getvalue()


def _entry(value: Any, key: str | None) -> Any:
    if key is None:
        return value
    return value.get(key, type(next(iter(value.values()), 0))())  # what is not counted is 0


def _flat(row: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, Estimate):
            ends = {name: value.value, f"{name}_low": value.low, f"{name}_high": value.high}
            yield from ((key, f"{number:.6g}" if np.isfinite(number) else "") for key, number in ends.items())
        elif isinstance(value, dict):
            yield from _flat({f"{name}.{key}": entry for key, entry in value.items()})
        else:
            yield name, f"{value:.6g}" if isinstance(value, float) else value
