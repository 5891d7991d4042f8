"""Tables I and II of the paper, its numbers beside ours.

The paper gives one outcome for each of its objects, in its own scenes and by a criterion without a formula; ours are
rates over all draws, of the first and of the top-ranked. So its columns orient, and no more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dexnudge.evaluation.lines import Line
from dexnudge.evaluation.markdown import markdown_table

TABLE_1 = {  # success [%]: scene -> (DGA, ours)
    "table": (31.7, 73.2),
    "layers": (39.0, 78.0),
    "shelf": (0.0, 63.4),
}
TABLE_2 = {  # [%]: scene -> guidance only, guidance + projection, each (non-penetration, manipulation feasibility)
    "table": ((26.8, 0.0), (100.0, 73.2)),
    "layers": ((0.0, 0.0), (100.0, 78.0)),
    "shelf": ((24.4, 0.0), (73.2, 63.4)),
}
GRASPS, FULL = 0, 1  # columns of Table I
ONLY, PROJECTED = 0, 1  # rows of Table II


@dataclass(frozen=True)
class PaperRow:
    """One of our methods beside the row of the paper that it stands for."""

    method: str
    meaning: str
    paper: int


ROWS_1 = (
    PaperRow("grasp_projection", "grasps only", GRASPS),
    PaperRow("paper", "Eq. 5 + projection", FULL),
    PaperRow("ours", "ours", FULL),
)
ROWS_2 = (
    PaperRow("paper_guidance_only", "Eq. 5, guidance only", ONLY),
    PaperRow("paper", "Eq. 5, guidance + projection", PROJECTED),
    PaperRow("guidance_only", "ours, guidance only", ONLY),
    PaperRow("ours", "ours, guidance + projection", PROJECTED),
)


def table_1(parts: Mapping[str, Sequence[Line]]) -> str:
    """Success [%] by scene; `parts`: how the hand or the model differs -> its lines."""
    header = ["scene", "method", "hand and model", "the paper", "single", "first", "top-ranked", "top-ranked robust"]
    rows = []
    for scene, row, part, line in _matching(parts, ROWS_1):
        paper = TABLE_1[scene][row.paper] if scene in TABLE_1 else ""
        rates = (line.single, line.first, line.top, line.top_robust)
        rows.append([scene, row.meaning, part, paper, *(rate.percent() for rate in rates)])
    return markdown_table(header, rows, names=3)


def table_2(parts: Mapping[str, Sequence[Line]]) -> str:
    """Non-penetration and manipulation feasibility [%] by scene, of all draws; and of the top-ranked."""
    header = ["scene", "method", "hand and model", "the paper: non-penetration", "feasibility"]
    header += ["non-penetration, all draws", "feasibility, all draws", "feasibility, top-ranked"]
    rows = []
    for scene, row, part, line in _matching(parts, ROWS_2):
        paper = TABLE_2[scene][row.paper] if scene in TABLE_2 else ("", "")
        rates = (line.clean, line.single, line.top)
        rows.append([scene, row.meaning, part, *paper, *(rate.percent() for rate in rates)])
    return markdown_table(header, rows, names=3)


def _matching(parts: Mapping[str, Sequence[Line]], wanted: Sequence[PaperRow]) -> list[tuple[str, PaperRow, str, Line]]:
    """(scene, row, part, line) of every line that stands for a row, by scene, then row, then part."""
    scenes = dict.fromkeys(line.scene for lines in parts.values() for line in lines)
    return [
        (scene, row, part, line)
        for scene in scenes
        for row in wanted
        for part, lines in parts.items()
        for line in lines
        if (line.scene, line.method) == (scene, row.method)
    ]
