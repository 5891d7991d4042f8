"""The figures of executions over all attempted objects: rates, and what they depend on."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dexnudge.evaluation.estimate import Estimate, estimate_of_sums, mean_estimate, ratio
from dexnudge.execution.experiment_rows import Executed, ExecutionRow

AS_PLANNED = "as planned"
MARGIN_EDGES = (
    1.0,
    1.25,
    1.5,
    2.0,
    2.5,
    3.0,
)  # of the bins of force margins; those that are capped have a bin of their own
CAPPED = "3 (cap)"
UNVERIFIED = "no draw verified"


@dataclass(frozen=True)
class ExecutedLine:
    """One scene and method over all attempted objects.

    Attributes:
        objects, failed: attempted, and those of them that could not be read, placed or simulated.
        unverified: objects without a verified draw.
        top: share of all attempted objects whose top-ranked verified draw succeeds in physics.
        executed: configurations; `single` the share of them that succeeds, None where none was executed.
        failures: executed configurations by reason, and objects whose top-ranked one was not there to be executed.
    """

    scene: str
    method: str
    objects: int
    failed: int
    unverified: int
    top: Estimate
    executed: int
    single: Estimate | None
    failures: dict[str, int]


@dataclass(frozen=True)
class Group:
    """Executed configurations that have something in common: how many, of how many objects, and how many succeed."""

    executed: int
    objects: int
    rate: Estimate


def executed_lines(rows: Sequence[ExecutionRow]) -> list[ExecutedLine]:
    """One line for each scene and method, in the order of their first rows."""
    groups: dict[tuple[str, str], list[ExecutionRow]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.method), []).append(row)
    return [_line(scene, method, group) for (scene, method), group in groups.items()]


def _line(scene: str, method: str, rows: list[ExecutionRow]) -> ExecutedLine:
    executed = [each for row in rows for each in row.configurations]
    failures = Counter(each.kind_of_failure for each in executed if not each.success)
    failed = sum(row.status == "failed" for row in rows)
    unverified = sum(row.status == "executed" and not row.configurations for row in rows)
    failures.update({name: count for name, count in (("object failed", failed), (UNVERIFIED, unverified)) if count})
    every = grouped(rows, lambda _: "all")
    return ExecutedLine(
        scene=scene,
        method=method,
        objects=len(rows),
        failed=failed,
        unverified=unverified,
        top=mean_estimate([float(row.top_succeeded) for row in rows]),
        executed=len(executed),
        single=every["all"].rate if every else None,
        failures=dict(failures.most_common()),
    )


def grouped(
    rows: Iterable[ExecutionRow], name: Callable[[Executed], str], *, order: Sequence[str] = ()
) -> dict[str, Group]:
    """Executed configurations by name, those in `order` first; intervals by bootstrap over the objects that have any.

    An object stands in several rows, once for each scene and method: all of its configurations are resampled together.
    """
    counts: dict[str, dict[str, list[int]]] = {key: {} for key in order}
    for row in rows:
        for each in row.configurations:
            sums = counts.setdefault(name(each), {}).setdefault(row.object, [0, 0])
            sums[0] += each.success
            sums[1] += 1
    return {key: _group(list(objects.values())) for key, objects in counts.items() if objects}


def _group(sums: list[list[int]]) -> Group:
    columns = np.array(sums, dtype=np.float64)
    return Group(int(columns[:, 1].sum()), len(columns), estimate_of_sums(columns, ratio))


def margin_bins() -> list[str]:
    """Names of the bins of force margins, ascending."""
    return [f"{low:g} to {high:g}" for low, high in pairwise(MARGIN_EDGES)] + [CAPPED]


def margin_bin(margin: float) -> str:
    """The bin of a verified configuration's force margin: its lower edge belongs to it, its upper one to the next."""
    return margin_bins()[int(np.searchsorted(MARGIN_EDGES, margin, side="right")) - 1]


def calibration(rows: Sequence[ExecutionRow]) -> dict[str, dict[str, Group]]:
    """Scene -> bin of force margin -> executed configurations; of all scenes together first, under "all"."""
    scenes = list(dict.fromkeys(row.scene for row in rows))
    chosen = {"all": list(rows), **{scene: [row for row in rows if row.scene == scene] for scene in scenes}}
    return {
        scene: grouped(some, lambda each: margin_bin(each.force_margin), order=margin_bins())
        for scene, some in chosen.items()
    }


def changed_rates(rows: Sequence[ExecutionRow]) -> dict[str, Estimate]:
    """Setting -> share of the objects' top-ranked draws that succeed there, over the rows that were played so.

    `AS_PLANNED` is their rate without an error.
    """
    played = [each for row in rows for each in row.configurations if each.changed]
    if not played:
        return {}
    rates = {AS_PLANNED: [float(each.success) for each in played]}
    for setting in played[0].changed:
        rates[setting] = [float(each.changed[setting]) for each in played]
    return {setting: mean_estimate(values) for setting, values in rates.items()}
