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
    shown = [each for each in metrics if each.header and any(row[each.name] is not None for row in measured)]
    rows = [
        [row["scene"], row["method"], *(row[label] for label in labels), *(each.text(row[each.name]) for each in shown)]
        for row in measured
    ]
    return Table(["scene", "method", *labels, *(each.header for each in shown)], rows, labels=2 + len(labels))


def count_table(measured: Sequence[Measured], name: str) -> Table:
    """Return a row for each scene and method, and a column for everything that a metric of counts has counted."""
    keys = dict.fromkeys(key for row in measured for key in row[name])
    rows = [[row["scene"], row["method"], *(row[name].get(key, 0) for key in keys)] for row in measured if keys]
    return Table(["scene", "method", *keys], rows)


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


def _flat(row: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, Estimate):
            ends = {name: value.value, f"{name}_low": value.low, f"{name}_high": value.high}
            yield from ((key, f"{number:.6g}" if np.isfinite(number) else "") for key, number in ends.items())
        elif isinstance(value, dict):
            yield from _flat({f"{name}.{key}": entry for key, entry in value.items()})
        else:
            yield name, f"{value:.6g}" if isinstance(value, float) else value
