"""Lines as markdown tables: rates, measures, why draws were rejected, and where the time went."""

from collections.abc import Sequence

from dexnudge.experiments.lines import Line
from dexnudge.experiments.markdown import markdown_table, number
from dexnudge.experiments.method_names import method_name
from dexnudge.experiments.statistics import Estimate

KEY = ("scene", "method")


def rate_table(lines: Sequence[Line]) -> str:
    """Rates in percent of what was attempted, with 95 % intervals over objects."""
    best_of = sorted({k for line in lines for k in line.best_of})
    header = [*KEY, "objects", "failed", "draws", "single", "single robust", "first"]
    header += [f"top of {k}" for k in best_of]
    header += ["top-ranked", "top-ranked robust", "any of n", "verified/s"]
    rows = []
    for line in lines:
        chosen = [line.best_of[k].percent() if k in line.best_of else "" for k in best_of]
        before, after = [line.single, line.single_robust, line.first], [line.top, line.top_robust, line.any]
        rows.append(
            [
                *_key(line),
                line.objects,
                line.failed,
                line.samples,
                *(rate.percent() for rate in before),
                *chosen,
                *(rate.percent() for rate in after),
                line.verified_per_second.text(1),
            ]
        )
    return markdown_table(header, rows)


def measure_table(lines: Sequence[Line]) -> str:
    """Depth, margin, variety and cost."""
    header = [
        *KEY,
        "no penetration > 1 mm, %",
        "worst depth, mm",
        "95th percentile, mm",
        "margin",
        "of top-ranked",
        "joint spread, rad",
        "contact spread, half lengths",
        "objects with a spread",
        "s per verified",
    ]
    rows = [
        [
            *_key(line),
            line.clean.percent(),
            _text(line.depth_mm),
            number(line.depth_95_mm),
            _text(line.margin),
            _text(line.top_margin),
            _text(line.joint_diversity),
            _text(line.contact_diversity),
            line.spread_objects,
            line.verified_per_second.inverse().text(),
        ]
        for line in lines
    ]
    return markdown_table(header, rows)


def rejection_table(lines: Sequence[Line]) -> str:
    """Rejected draws by reason."""
    reasons = list(dict.fromkeys(reason for line in lines for reason in line.rejected))
    if not reasons:
        return "None were."
    rows = [[*_key(line), *(line.rejected.get(reason, 0) for reason in reasons)] for line in lines]
    return markdown_table([*KEY, *reasons], rows)


def seconds_table(lines: Sequence[Line]) -> str:
    """Mean seconds of a row by stage."""
    stages = list(dict.fromkeys(stage for line in lines for stage in line.seconds))
    rows = [[*_key(line), *(f"{line.seconds.get(stage, 0.0):.2f}" for stage in stages)] for line in lines]
    return markdown_table([*KEY, *stages], rows)


def _key(line: Line) -> list[str]:
    return [line.scene, method_name(line.method)]


def _text(estimate: Estimate | None) -> str:
    return estimate.text() if estimate else ""
