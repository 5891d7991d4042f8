"""Figures of many trials: metrics by scene and method, and rates by group, with intervals over objects."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dexnudge.experiments.records import Record
from dexnudge.experiments.statistics import Estimate, estimate_of_sums, ratio

Value = Estimate | float | int | dict[str, Any] | None
Measured = dict[str, Any]
"""The figures of one scene and method: "scene", "method", and the name of each metric -> `Value`."""


@dataclass(frozen=True)
class Metric:
    """One figure over the records of all attempted objects in one scene with one method.

    Attributes:
        name: in report.json and in CSV files. header: in tables.
        of: the figure of some records. A dict gives a column for each of its keys.
        form: "percent" for shares, else the number of digits.
        about: what the figure is, one sentence.
    """

    name: str
    header: str
    of: Callable[[Sequence[Any]], Value]
    form: Literal["percent"] | int = "percent"
    about: str = ""

    def text(self, value: Value) -> str:
        """Return a value as the text of a table's cell; empty where there is none."""
        if isinstance(value, Estimate):
            return value.percent() if self.form == "percent" else value.text(self.form)
        if isinstance(value, float) and self.form != "percent":
            return f"{value:.{self.form}f}"
        return "" if value is None else str(value)


OBJECTS = Metric("objects", "objects", len, 0, "attempted, failed ones included")
FAILED = Metric(
    "failed", "failed", lambda records: _with_status(records, "failed"), 0, "could not be read, placed or run"
)
UNVERIFIED = Metric(
    "unverified",
    "unverified",
    lambda records: _with_status(records, "unverified"),
    0,
    "objects without a verified draw",
)


def by_scene_and_method(records: Sequence[Record]) -> dict[tuple[str, str], list[Record]]:
    """Return the records of each scene and method, in the order of the first ones."""
    groups: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        groups.setdefault((record.scene, record.method), []).append(record)
    return groups


def measure(records: Sequence[Record], metrics: Sequence[Metric]) -> list[Measured]:
    """Return the metrics of each scene and method."""
    return [
        {"scene": scene, "method": method, **{metric.name: metric.of(group) for metric in metrics}}
        for (scene, method), group in by_scene_and_method(records).items()
    ]


@dataclass(frozen=True)
class GroupRate:
    """Outcomes that have something in common: how many, of how many objects, and the share that succeeds."""

    number: int
    objects: int
    rate: Estimate


def group_rates(outcomes: Iterable[tuple[str, str, bool]]) -> dict[str, GroupRate]:
    """Return the rate of each group of outcomes (group, object, success), by name of the group.

    Intervals are by bootstrap over the objects that have any: all that belongs to an object is resampled together, also
    where it stands in several scenes.
    """
    counts: dict[str, dict[str, list[int]]] = {}
    for group, name, success in outcomes:
        sums = counts.setdefault(group, {}).setdefault(name, [0, 0])
        sums[0] += success
        sums[1] += 1
    columns = {group: np.array(list(sums.values()), dtype=np.float64) for group, sums in sorted(counts.items())}
    return {
        group: GroupRate(int(each[:, 1].sum()), len(each), estimate_of_sums(each, ratio))
        for group, each in columns.items()
    }


def named(metrics: Sequence[Metric], *names: str) -> list[Metric]:
    """Return the metrics of these names, in this order."""
    known = {metric.name: metric for metric in metrics}
    return [known[name] for name in names]


def _with_status(records: Sequence[Record], status: str) -> int:
    return sum(record.status == status for record in records)
