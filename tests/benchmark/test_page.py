"""The page of a score: its figures are those of the CSV, its pictures those of the draws, and nothing in it is markup."""

import csv
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from dexnudge.benchmark.page import one_line
from dexnudge.benchmark.records import ScoreRecord
from dexnudge.benchmark.score import score
from dexnudge.experiments.records import read_records

MARKUP = "<script>alert(1)</script> \"A\" & 'B' <img src=x>"


class Page(HTMLParser):
    """Rows of cells, lines of lists, captions of pictures, and what a page loads or runs."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.rows, self.lines, self.captions = [], [], [], [], []
        self.within = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "data", "action")]
        if tag == "br":
            self.captions[-1].append("")
            return
        self.within = tag
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
        elif tag == "li":
            self.lines.append("")
        elif tag == "figcaption":
            self.captions.append([""])

    def handle_endtag(self, tag):
        if tag == self.within:
            self.within = ""

    def handle_data(self, data):
        if self.within in ("td", "th"):
            self.rows[-1][-1] += data
        elif self.within == "li":
            self.lines[-1] += data
        elif self.within == "figcaption":
            self.captions[-1][-1] += data


@pytest.fixture
def two_entries(entry_folder, tasks, inside, tmp_path):
    """One entry with markup in what it says, and one that lacks an answer, has a draw of NaN and one far away."""
    said = json.loads((entry_folder / "entry.json").read_text())
    other = tmp_path / "other"
    (other / "answers").mkdir(parents=True)
    (other / "entry.json").write_text(json.dumps(said | {"name": "other"}))
    nothing, far = np.array(inside["T_world_palm"]), np.array(inside["T_world_palm"])
    nothing[0, 0, 3], far[:, 0, 3] = np.nan, 1e30
    by_family = {"layers": nothing, "shelf": far}
    for task in tasks.tasks:
        if task.family in by_family:
            answer = {**inside, "T_world_palm": by_family[task.family].tolist()}
            (other / "answers" / f"{task.name}.json").write_text(json.dumps(answer))
    (entry_folder / "entry.json").write_text(json.dumps(said | {"authors": MARKUP, "used": "$x_1$ and $y"}))
    return [entry_folder, other]


def test_the_page_shows_figures_with_intervals_pictures_and_every_text_as_it_is(two_entries, tasks, tmp_path):
    score(two_entries, tasks.folder, tmp_path / "out", workers=1)
    text = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    page = Page(text)
    # nothing is run or loaded
    assert not {"script", "link", "iframe", "object"} & {*page.tags}
    assert all(re.match(r"data:image/(png|svg\+xml);base64,", link) for link in page.links)
    assert "default-src 'none'" in text
    assert MARKUP in next(line for line in page.lines if line.startswith("mine: "))
    # figures of both entries, with intervals, in every scene and in all
    with (tmp_path / "out/report.csv").open() as file:
        figures = {f"{row['scene']}, {row['method']}": row for row in csv.DictReader(file)}
    header, *rows = page.rows[:9]
    assert [row[0] for row in rows] == list(figures)
    assert {*figures} == {
        f"{scene}, {entry}" for scene in ("all", *tasks.suite.families) for entry in ("mine", "other")
    }
    for name, *cells in rows:
        shown = dict(zip(header[1:], cells, strict=True))
        for column, figure in (("first verified", "first"), ("share verified", "share"), ("feedback", "feedback")):
            value, low, high = (100 * float(figures[name][f"{figure}{end}"]) for end in ("", "_low", "_high"))
            assert shown[column] == f"{value:.1f} ({low:.0f}-{high:.0f})"
        assert shown["answered"] == figures[name]["answered"]
    # a picture of each first draw that can be seen, under its verdict
    found = {
        (each.method, task.task): task
        for entry in ("mine", "other")
        for each in read_records(tmp_path / "out/entries" / entry, ScoreRecord)
        for task in each.tasks
    }
    firsts = [(entry, f"phone-200_{family}_0") for family in tasks.suite.families for entry in ("mine", "other")]
    assert [caption[0] for caption in page.captions] == [entry for entry, _ in firsts]
    for caption, key in zip(page.captions, firsts, strict=True):
        assert caption[1] == (f"rejected: {found[key].rejected}" if found[key].drawn else found[key].problem)
    assert page.captions[1][1] == "there is no answer"
    assert page.captions[3][1] == "rejected: valid pose"
    assert sum(link.startswith("data:image/png") for link in page.links) == 3  # of mine alone
    assert text.count('<div class="none">') == 3
    assert sum(link.startswith("data:image/svg") for link in page.links) == 2  # charts


def test_a_page_is_the_same_again(entry_folder, tasks, tmp_path):
    score([entry_folder], tasks.folder, tmp_path / "out", workers=1)
    before = (tmp_path / "out/report.html").read_bytes()
    score([entry_folder], tasks.folder, tmp_path / "out", workers=1)
    assert (tmp_path / "out/report.html").read_bytes() == before


def test_lines_show_every_character():
    assert one_line("a\n\u202eb\x1b") == r"a \u202eb\x1b"
