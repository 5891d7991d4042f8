"""How success holds up where friction or mass is other than it was thought to be."""

from collections.abc import Sequence
from dataclasses import dataclass

from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.method_names import method_name
from dexnudge.experiments.rows import Row
from dexnudge.experiments.statistics import Estimate, mean_estimate

QUANTITIES = {  # of a scene -> what reports call it
    "friction_environment": "friction on the surroundings",
    "friction_hand": "friction on the hand",
    "mass": "mass",
}
AS_DRAWN = "as drawn"  # the setting for which the draws were made and ranked


@dataclass(frozen=True)
class SweepLine:
    """One scene, method and setting over all attempted objects.

    Attributes:
        single: share of all draws that succeed there.
        top: share of objects whose top-ranked draw, ranked at the values for which it was drawn, succeeds there.
        any: share of objects with at least one draw that succeeds there.
    """

    scene: str
    method: str
    setting: str
    single: Estimate
    top: Estimate
    any: Estimate


def sweep_lines(rows: Sequence[Row]) -> list[SweepLine]:
    """The lines of every setting that the rows were judged at; draws of failed objects count as none that succeeds."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.method), []).append(row)
    lines = []
    for (scene, method), group in groups.items():
        settings = list(dict.fromkeys(setting for row in group for setting in row.swept))
        for setting in [AS_DRAWN, *settings] if settings else []:
            success = [row.success if setting == AS_DRAWN else row.swept.get(setting, []) for row in group]
            lines.append(
                SweepLine(
                    scene=scene,
                    method=method,
                    setting=setting,
                    single=mean_estimate([sum(ok) / row.num for ok, row in zip(success, group, strict=True)]),
                    top=mean_estimate([float(any(ok[:1])) for ok in success]),
                    any=mean_estimate([float(any(ok)) for ok in success]),
                )
            )
    return lines


def setting_text(setting: str) -> str:
    """What reports call a setting."""
    quantity, times, factor = setting.partition(" x ")
    return f"{QUANTITIES[quantity]} × {factor}" if times else setting


def sweep_table(lines: Sequence[SweepLine]) -> str:
    """Rates in percent with 95 % intervals over objects."""
    rows = [
        [
            line.scene,
            method_name(line.method),
            setting_text(line.setting),
            *(rate.percent() for rate in (line.single, line.top, line.any)),
        ]
        for line in lines
    ]
    return markdown_table(["scene", "method", "setting", "single", "top-ranked", "any of n"], rows, names=3)
