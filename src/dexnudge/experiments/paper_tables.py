"""Tables I and II of the paper, its numbers beside ours.

The paper gives one outcome for each of its objects, in its own scenes and by a criterion without a formula; ours are
rates over all draws, of the first and of the top-ranked. So its columns orient, and no more.
"""

from collections.abc import Mapping, Sequence

from dexnudge.experiments.lines import Line
from dexnudge.experiments.markdown import markdown_table
from dexnudge.experiments.method_names import method_name

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


ROWS_1 = {  # one of our methods -> the paper's column that it stands for
    "grasp_projection": GRASPS,
    "paper": FULL,
    "steered_noise": FULL,
}
ROWS_2 = {  # one of our methods -> the paper's row that it stands for
    "paper_guidance_only": ONLY,
    "paper": PROJECTED,
    "guidance_only": ONLY,
    "steered_noise": PROJECTED,
}


def table_1(parts: Mapping[str, Sequence[Line]]) -> str:
    """Success [%] by scene; `parts`: how the hand or the model differs -> its lines."""
    header = ["scene", "method", "hand and model", "the paper", "single", "first", "top-ranked", "top-ranked robust"]
    rows = []
    for scene, column, part, line in _matching(parts, ROWS_1):
        paper = TABLE_1[scene][column] if scene in TABLE_1 else ""
        rates = (line.single, line.first, line.top, line.top_robust)
        rows.append([scene, method_name(line.method), part, paper, *(rate.percent() for rate in rates)])
    return markdown_table(header, rows, names=3)


def table_2(parts: Mapping[str, Sequence[Line]]) -> str:
    """Non-penetration and manipulation feasibility [%] by scene, of all draws; and of the top-ranked."""
    header = ["scene", "method", "hand and model", "the paper: non-penetration", "feasibility"]
    header += ["non-penetration, all draws", "feasibility, all draws", "feasibility, top-ranked"]
    rows = []
    for scene, place, part, line in _matching(parts, ROWS_2):
        paper = TABLE_2[scene][place] if scene in TABLE_2 else ("", "")
        rates = (line.clean, line.single, line.top)
        rows.append([scene, method_name(line.method), part, *paper, *(rate.percent() for rate in rates)])
    return markdown_table(header, rows, names=3)


def _matching(parts: Mapping[str, Sequence[Line]], wanted: Mapping[str, int]) -> list[tuple[str, int, str, Line]]:
    """(scene, place in the paper, part, line) of every line that stands there, by scene, then method, then part."""
    scenes = dict.fromkeys(line.scene for lines in parts.values() for line in lines)
    return [
        (scene, place, part, line)
        for scene in scenes
        for method, place in wanted.items()
        for part, lines in parts.items()
        for line in lines
        if (line.scene, line.method) == (scene, method)
    ]
