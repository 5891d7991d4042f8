"""The figures of slide, grasp and lift over all attempted objects."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from dexnudge.experiments.experiment_lines import UNVERIFIED
from dexnudge.experiments.lift_experiment_rows import LiftRow
from dexnudge.experiments.statistics import Estimate, mean_estimate, mean_of_known


@dataclass(frozen=True)
class LiftLine:
    """One scene and method over all attempted objects.

    Attributes:
        objects, failed: attempted, and those of them that could not be read, placed or simulated.
        unverified: objects without a verified draw.
        lifted, at_first: share of all attempted objects that was lifted and held, at any try and at the first.
        tries, draw, play, simulated: of the objects that were played: tries, seconds of drawing and of the story, seconds in
            the simulation; None where none was.
        failures, first_failures: objects that were not lifted, by what went wrong at the last try and at the first.
    """

    scene: str
    method: str
    objects: int
    failed: int
    unverified: int
    lifted: Estimate
    at_first: Estimate
    tries: Estimate | None
    draw: Estimate | None
    play: Estimate | None
    simulated: Estimate | None
    failures: dict[str, int]
    first_failures: dict[str, int]


def lift_lines(rows: Sequence[LiftRow]) -> list[LiftLine]:
    """One line for each scene and method, in the order of their first rows."""
    groups: dict[tuple[str, str], list[LiftRow]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.method), []).append(row)
    return [_line(scene, method, group) for (scene, method), group in groups.items()]


def _line(scene: str, method: str, rows: list[LiftRow]) -> LiftLine:
    played = [row for row in rows if row.status == "played"]
    unverified = sum(row.status == "failed" and row.reason == UNVERIFIED for row in rows)
    return LiftLine(
        scene=scene,
        method=method,
        objects=len(rows),
        failed=len(rows) - len(played) - unverified,
        unverified=unverified,
        lifted=mean_estimate([float(row.lifted) for row in rows]),
        at_first=mean_estimate([float(row.lifted_at_first) for row in rows]),
        tries=mean_of_known(float(len(row.tries)) for row in played),
        draw=mean_of_known(row.seconds["draw"] for row in played),
        play=mean_of_known(row.seconds["play"] for row in played),
        simulated=mean_of_known(row.simulated for row in played),
        failures=_counted(row.failure_of(-1) for row in rows),
        first_failures=_counted(row.failure_of(0) for row in rows),
    )


def _counted(failures: Iterable[str]) -> dict[str, int]:
    """Most frequent first; successes left out."""
    return dict(Counter(failure for failure in failures if failure).most_common())
