"""The figures of executions over all attempted objects: rates, and what they depend on."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dexnudge.experiments.experiment_rows import Executed, ExecutionRow
from dexnudge.experiments.statistics import Estimate, estimate_of_sums, mean_estimate, ratio

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


def per_scene(
    rows: Sequence[ExecutionRow], figures: Callable[[list[ExecutionRow]], dict[str, Group]]
) -> dict[str, dict[str, Group]]:
    """`figures` of all rows, under "all", and of each scene's."""
    scenes = list(dict.fromkeys(row.scene for row in rows))
    return {
        "all": figures(list(rows)),
        **{name: figures([row for row in rows if row.scene == name]) for name in scenes},
    }


def grouped(
    rows: Iterable[ExecutionRow], name: Callable[[Executed], str], *, order: Sequence[str] = ()
) -> dict[str, Group]:
    """Executed configurations by name, those in `order` first."""
    return _groups(((name(each), row.object, each.success) for row in rows for each in row.configurations), order)


def changed_rates(rows: Iterable[ExecutionRow]) -> dict[str, Group]:
    """Top-ranked draws that were played with errors, by setting; `AS_PLANNED` are the same ones without an error."""
    played = [(row.object, each) for row in rows for each in row.configurations if each.changed]
    return _groups(
        (setting, name, success)
        for name, each in played
        for setting, success in {AS_PLANNED: each.success, **each.changed}.items()
    )


def _groups(outcomes: Iterable[tuple[str, str, bool]], order: Sequence[str] = ()) -> dict[str, Group]:
    """(group, object, success) by group; intervals by bootstrap over the objects that have any.

    All that belongs to an object is resampled together, also where it stands in several scenes.
    """
    counts: dict[str, dict[str, list[int]]] = {key: {} for key in order}
    for key, name, success in outcomes:
        sums = counts.setdefault(key, {}).setdefault(name, [0, 0])
        sums[0] += success
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
    """Scene -> bin of force margin -> executed configurations; see `per_scene`."""
    return per_scene(rows, lambda some: grouped(some, lambda each: margin_bin(each.force_margin), order=margin_bins()))
