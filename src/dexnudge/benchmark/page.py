"""The page of a score: charts and tables with intervals, and pictures of first draws; no network, no script."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from dexnudge.benchmark.entry import Answer, Entry, read_answer
from dexnudge.benchmark.records import Records, TaskScore
from dexnudge.benchmark.suite import TaskKey
from dexnudge.benchmark.tasks import TaskSet
from dexnudge.dataset import document
from dexnudge.dataset.document import Document, Section
from dexnudge.dataset.page import chart_html, document_page, picture_html, pictures_html
from dexnudge.errors import printable
from dexnudge.experiments.metrics import Measured
from dexnudge.experiments.statistics import Estimate
from dexnudge.experiments.tables import AVAILABLE, MISSING, Table, interval_chart
from dexnudge.hands.hand import Hand
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import verify
from dexnudge.viewer.picture import render_array
from dexnudge.viewer.visual_scene import visual_scenes

MOST_PICTURED = 5  # entries: a row of pictures
COLOURS = "In the pictures: yellow, where hand and object touch; green, the motion; glass, what would hide them."
TILE = (560, 480)  # pixels of one picture
REACH = 1.0  # [m] between palm and object beyond which there is no picture of both


PAGE = "report.html"
Lists = Mapping[str, Sequence[str]]


def write_page(path: Path, title: str, about: str, tables: Mapping[str, Table], lists: Lists, *, pictures: str) -> None:
    """Write the page.

    Args:
        path: of the HTML file.
        title: plain text, as `about`, tables and lists; whatever stands in them is shown, never interpreted.
        about: what was judged.
        tables: heading -> figures of each scene and entry.
        lists: heading -> lines.
        pictures: HTML between `about` and the tables.

    Raises:
        OutputError: the file cannot be written.
    """
    sections = [Section(heading, (_by_scene_and_entry(table),)) for heading, table in tables.items()]
    sections += [
        Section(heading, ("\n".join(f"- {one_line(line)}" for line in lines),)) for heading, lines in lists.items()
    ]
    with replace_atomically(path) as temporary:
        page = document_page(Document(title, about, tuple(sections)), pictures)
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace")


def one_line(text: str) -> str:
    """Return a text in one line in which every character is shown."""
    return printable(" ".join(text.splitlines()))


def _by_scene_and_entry(table: Table) -> document.Table:
    """Return a table whose rows are labelled by scene and entry."""
    rows = tuple((f"{scene}, {entry}", *cells) for scene, entry, *cells in table.rows)
    return document.Table("scene, entry", ("scene, entry", *table.header[2:]), rows)


def rate_charts(measured: Sequence[Measured], titles: Mapping[str, str]) -> str:
    """Return a chart for each of these metrics, by scene and entry, as HTML; a sentence without matplotlib."""
    if not AVAILABLE:
        return f"<p>{escape(MISSING)}</p>"
    images = []
    for name, title in titles.items():
        groups: dict[str, dict[str, Estimate]] = {}
        for row in measured:
            groups.setdefault(row["scene"], {})[row["method"]] = row[name]
        images.append(chart_html(interval_chart(title, groups), title))
    return "\n".join(['<div class="charts">', *images, "</div>"])


def first_draws(entries: Sequence[Entry], tasks: TaskSet, records: Records) -> str:
    """Return pictures of the first draws of each family's first task, side by side, each with its verdict; as HTML.

    Raises:
        HandError: the hand of the tasks cannot be loaded.
    """
    scores = {(each.method, task.task): task for each in records for task in each.tasks}
    first = {task.family: task for task in reversed(tasks.tasks)}
    rows = []
    for family in tasks.suite.families:
        if family in first:
            task = first[family]
            scene = tasks.scene(task)
            shown = [
                _first_draw(entry, tasks, task, scene, scores[entry.name, task.name])
                for entry in entries[:MOST_PICTURED]
            ]
            rows.append(pictures_html(f"First draws in {family}, {task.object}", shown))
    return "\n".join([f"<p>{COLOURS}</p>", *rows])


def _first_draw(entry: Entry, tasks: TaskSet, task: TaskKey, scene: Scene, score: TaskScore) -> str:
    picture, caption = None, [score.problem or "no draws"]
    if score.drawn:
        picture = _picture(scene, tasks.hand, read_answer(entry, task.name, tasks.hand, most=tasks.suite.draws))
        caption = [f"rejected: {score.rejected}" if score.rejected else "verified"]
        caption += [f"in physics, with feedback: {score.feedback.replace('_', ' ')}"]
        caption += [f"{score.verified} of {score.drawn} draws verified"]
    return picture_html(picture, [entry.name, *map(one_line, caption)], about=task.name)


def _picture(scene: Scene, hand: Hand, answer: Answer) -> UInt8[np.ndarray, "height width 3"] | None:
    """Return the picture of the first draw with its contacts; None where it has no pose, or one far from the object."""
    q = answer.q[:1]
    if not np.linalg.norm(q[0, :3] - scene.object_in_world().bounds.mean(axis=0)) <= REACH:  # nor NaN
        return None
    contacts = verify(scene, hand, q).contacts[0].points
    return render_array(visual_scenes(scene, hand, q, contacts=[contacts])[0], size=TILE)
