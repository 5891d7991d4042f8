"""Where a method does worst, and why: for the failures that a report shows."""

from collections.abc import Sequence
from dataclasses import dataclass

from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.reproduction_parts import Part
from dexnudge.experiments.rows import Row

MOST_CASES = 3
REASONS = {  # a reason of the judge -> what it means
    "valid_pose": "the draw is no pose",
    "joint_limits": "a joint is beyond its limits, or the two joints of a tendon are bent in the wrong order",
    "penetration_environment": "the hand or the forearm is more than 1 mm inside the surroundings",
    "penetration_object": "the hand is more than 1 mm inside the object",
    "penetration_self": "the hand is more than 1 mm inside itself",
    "contact": "no link touches the object",
    "motion_not_blocked": "the motion runs into what supports the object",
    "force_margin": "no forces of the contacts within their friction cones and limits move the object",
}


@dataclass(frozen=True)
class WorstCase:
    """An object and scene in which many draws of a method fail: the part of the run, and the row."""

    part: Part
    row: Row


def worst_cases(parts: Sequence[tuple[Part, Sequence[Row]]], method: str) -> list[WorstCase]:
    """The rows of a method with the smallest share of verified draws, worst first; at most `MOST_CASES`.

    No two are from the same scene as long as there are others. Neither a row without a rejected draw is taken nor that
    of a failed object, which has no draws.
    """
    found = [
        WorstCase(part, row) for part, rows in parts for row in rows if row.method == method and not all(row.success)
    ]
    found.sort(key=lambda case: sum(case.row.success) / case.row.num)
    first_of_scene: dict[str, WorstCase] = {}
    for case in found:
        first_of_scene.setdefault(case.row.scene, case)
    chosen = list(first_of_scene.values())
    chosen += [case for case in found if case not in chosen]
    return chosen[:MOST_CASES]


def reason_table(row: Row) -> str:
    """Rejected draws by reason, with what each reason means."""
    rows = [[reason, REASONS.get(reason, ""), count] for reason, count in row.rejected.items()]
    return markdown_table(["reason", "meaning", "draws"], rows)
