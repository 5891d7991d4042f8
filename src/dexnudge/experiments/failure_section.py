"""The failures that a report shows: where, how many, for which reasons, and one of them in a picture."""

from collections.abc import Sequence

from dexnudge.experiments.method_names import method_name
from dexnudge.experiments.rejected_pictures import RejectedDraw
from dexnudge.experiments.worst_cases import WorstCase, reason_table

ABOUT = (
    "Where dexnudge verifies the smallest share of its draws, one case from each scene first. In the pictures: yellow, "
    "where hand and object touch; green, the motion; the grey box is the forearm."
)
NUMBERS = ("No", "One", "Two", "Three")


def failure_section(cases: Sequence[WorstCase], shown: Sequence[RejectedDraw | None], pictures: str) -> list[str]:
    """Headings and texts; `shown`: a rejected draw of each case, `pictures`: the folder of their pictures in links."""
    if not cases:
        return ["## Failures", "No draw of dexnudge was rejected."]
    many = "failure" if len(cases) == 1 else "failures"
    found = [f"## {NUMBERS[len(cases)]} {many}, and why", ABOUT]
    for case, draw in zip(cases, shown, strict=True):
        row = case.row
        found += [
            f"### {row.object}, {row.scene}: {sum(row.success)} of {row.num} draws of {method_name(row.method)} succeed",
            reason_table(row),
        ]
        if draw is not None:
            found += [_described(draw), f"![A rejected draw: {draw.reason}]({pictures}/{draw.picture.name})"]
    return found


def _described(draw: RejectedDraw) -> str:
    depths = {
        "surroundings": draw.penetration_environment,
        "object": draw.penetration_object,
        "hand itself": draw.penetration_self,
    }
    deep = ", ".join(f"{1e3 * depth:.2f} mm in {where}" for where, depth in depths.items())
    links = ", ".join(draw.contact_links) or "none"
    deepest = f" (deepest: {draw.deepest_link})" if draw.deepest_link else ""
    return (
        f"A rejected draw ({draw.reason}): depth {deep}{deepest}; links that touch the object: {links}; force margin "
        f"{draw.force_margin:.2f}, 1 is needed."
    )
