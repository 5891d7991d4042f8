"""Figures of many trials: metrics by scene and method, and rates by group, with intervals over objects."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dexnudge.experiments.records import Record
from dexnudge.experiments.statistics import Estimate, estimate_of_sums, mean_estimate, mean_of_known, ratio

Value = Estimate | float | int | dict[str, Any] | None
Measured = dict[str, Any]
"""The figures of one scene and method: "scene", "method", and the name of each metric -> `Value`."""


@dataclass(frozen=True)
class Metric:
    """One figure over the records of all attempted objects in one scene with one method.

    Attributes:
        name: in report.json and report.csv.
        of: the figure of some records.
        header: in the tables of report.md; "" for a figure that stands in the data files only.
        form: "percent" for shares, "counts" for a dict that has a table of its own, else the number of digits.
    """

    name: str
    of: Callable[[Sequence[Any]], Value]
    header: str = ""
    form: Literal["percent", "counts"] | int = "percent"

    def text(self, value: Value) -> str:
        """Return a value as the text of a table's cell; empty where there is none."""
        if isinstance(value, Estimate):
            return value.text(self.form) if isinstance(self.form, int) else value.percent()
        if isinstance(value, float) and isinstance(self.form, int):
            return f"{value:.{self.form}f}"
        return "" if value is None else str(value)


def share(good: Callable[[Any], float]) -> Callable[[Sequence[Any]], Estimate]:
    """Return the metric that is the mean over all attempted objects; `good` is a flag or share of a record."""
    return lambda records: mean_estimate([float(good(each)) for each in records])


def share_of(outcomes: Callable[[Any], Sequence[bool]]) -> Callable[[Sequence[Any]], Estimate | None]:
    """Return the metric that is the share of good outcomes among those of all records; None where none has any."""

    def found(records: Sequence[Any]) -> Estimate | None:
        counts = [[sum(each), len(each)] for each in map(outcomes, records) if each]
        return estimate_of_sums(np.array(counts, dtype=np.float64), ratio) if counts else None

    return found


def mean(value: Callable[[Any], float | None]) -> Callable[[Sequence[Any]], Estimate | None]:
    """Return the metric that is the mean over the trials that are done and have the number."""
    return lambda records: mean_of_known(value(each) for each in records if each.status == "done")


def number_with(status: str) -> Callable[[Sequence[Any]], int]:
    """Return the metric that counts the trials with a status."""
    return lambda records: sum(record.status == status for record in records)


OBJECTS = Metric("objects", len, "objects", 0)  # attempted, failed ones included
FAILED = Metric("failed", number_with("failed"), "failed", 0)  # could not be read, placed or run
UNVERIFIED = Metric("unverified", number_with("unverified"), "unverified", 0)  # without a verified draw


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


def named(metrics: Sequence[Metric], *names: str) -> list[Metric]:
    """Return the metrics of these names, in this order."""
    known = {metric.name: metric for metric in metrics}
    return [known[name] for name in names]


@dataclass(frozen=True)
class GroupRate:
    """Outcomes that have something in common: how many, of how many objects, and the share that succeeds."""

    number: int
    objects: int
    rate: Estimate


def group_rates(
    records: Sequence[Record], outcomes: Callable[[Record], Iterable[tuple[str, bool]]]
) -> Mapping[str, Mapping[str, GroupRate]]:
    """Return the rate of each group of outcomes (group, success), of "all" scenes and of each: scene -> group -> rate.

    Intervals are by bootstrap over the objects that have any: all that belongs to an object is resampled together, also
    where it stands in several scenes.
    """
    scenes = ["all", *dict.fromkeys(record.scene for record in records)]
    sums: dict[str, dict[str, dict[str, list[int]]]] = {scene: {} for scene in scenes}
    for record in records:
        for group, success in outcomes(record):
            for scene in ("all", record.scene):
                counts = sums[scene].setdefault(group, {}).setdefault(record.object, [0, 0])
                counts[0] += success
                counts[1] += 1
    found: dict[str, dict[str, GroupRate]] = {}
    for scene, groups in sums.items():
        columns = {group: np.array(list(counts.values()), dtype=np.float64) for group, counts in sorted(groups.items())}
        found[scene] = {
            group: GroupRate(int(each[:, 1].sum()), len(each), estimate_of_sums(each, ratio))
            for group, each in columns.items()
        }
    return found
