"""The page loads nothing, is well-formed, and its numbers are those of the rows."""

import base64
import re
from collections import Counter
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lxml import etree
from PIL import Image

from dexnudge.dataset.info import describe
from dexnudge.synthesis.dataset_page import RowPicture, write_dataset_page
from dexnudge.viewer.picture import GAP


class Page(HTMLParser):
    """The cells of every table, and every attribute that could load something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.links: list[str] = []
        self.tags: Counter[str] = Counter()
        self._inside = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "data", "action", "xlink:href")]
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        self._inside = tag in ("td", "th")
        if self._inside:
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = self._inside and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.tables[-1][-1][-1] += data

    def table(self, title: str) -> dict[str, dict[str, str]]:
        """Row label -> column -> cell of the table with this title."""
        rows = next(rows for rows in self.tables if rows[0][0] == title)
        return {row[0]: dict(zip(rows[0][1:], row[1:], strict=True)) for row in rows[1:]}


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    labels = ["grasp", "grasp", "push"]
    return [
        RowPicture(label, (f"<b>{k}</b>", "x & y"), rng.integers(0, 255, (240, 280, 3), dtype=np.uint8))
        for k, label in enumerate(labels)
    ]


def test_numbers_on_the_page_are_those_of_the_rows(toy_folder, samples, tmp_path):
    page = Page(write_dataset_page(describe(toy_folder), samples, tmp_path / "out")[0].read_text(encoding="utf-8"))
    rows = pa.concat_tables(pq.read_table(file) for file in toy_folder.glob("shard-*.parquet")).to_pylist()
    kept = Counter(row["behaviour"] for row in rows)
    counts = page.table("behaviour")
    assert {behaviour: int(counts[behaviour]["kept"]) for behaviour in counts} == {
        behaviour: kept[behaviour] for behaviour in ("grasp", "push", "press", "hook")
    }
    thumbs = sum("TH" in row["digits"] for row in rows if row["behaviour"] == "push")
    assert page.table("rows that use the digit")["push"]["TH"] == str(thumbs)
    along_y = sum(row["direction_margin"][4] >= 1 for row in rows)
    assert page.table("feasible direction [deg]")["rows"]["90"] == str(along_y)


def images(text: str) -> dict[str, etree._Element]:
    """The charts of a page by title."""
    found = re.findall(r'<img alt="([^"]+)" src="data:image/svg\+xml;base64,([^"]+)">', text)
    return {unescape(title): etree.fromstring(base64.b64decode(data)) for title, data in found}


def test_every_table_that_can_be_drawn_has_a_chart(toy_folder, samples, tmp_path):
    info = describe(toy_folder)
    text = write_dataset_page(info, samples, tmp_path / "out")[0].read_text(encoding="utf-8")
    drawn = images(text)
    assert set(drawn) == {table.title for table in info.tables.values() if table.chart}
    assert {"rows that use the digit", "feasible direction [deg]", "drift while held [mm] from"} <= set(drawn)
    svg = "{http://www.w3.org/2000/svg}"
    bars = [path for path in drawn["rows that use the digit"].iter(f"{svg}path") if "#3b6fb6" in path.get("style", "")]
    counts = list(info.tables["digits"].row("grasp").values())
    assert len(bars) == len(counts) + 1  # and one in the legend
    heights = [path_height(path.get("d")) for path in bars[:-1]]
    np.testing.assert_allclose(
        np.array(heights) * max(counts), np.array(counts) * max(heights), atol=1e-3 * max(heights)
    )


def path_height(path: str) -> float:
    numbers = [float(number) for number in re.findall(r"-?[\d.]+", path)]
    return max(numbers[1::2]) - min(numbers[1::2])


def test_without_matplotlib_the_page_has_its_tables_and_says_so(toy_folder, samples, tmp_path, monkeypatch):
    monkeypatch.setattr("dexnudge.synthesis.dataset_page.find_spec", lambda name: None)
    text = write_dataset_page(describe(toy_folder), samples, tmp_path / "out")[0].read_text(encoding="utf-8")
    assert not images(text)
    assert "Without charts: they are drawn by matplotlib, which is not installed; pip install dexnudge[plots]." in text
    assert Page(text).table("behaviour")["grasp"]["kept"] == "18"


def test_the_page_loads_nothing_and_interprets_no_text(toy_folder, samples, tmp_path):
    text = write_dataset_page(describe(toy_folder), samples, tmp_path / "out")[0].read_text(encoding="utf-8")
    page = Page(text)
    assert len(page.links) == page.tags["img"] == len(samples) + len(images(text))
    assert all(link.startswith(("data:image/png;base64,", "data:image/svg+xml;base64,")) for link in page.links)
    assert not re.search(r"https?://|url\(|@import|<script|<link", text)
    assert page.tags["b"] == 0
    assert "&lt;b&gt;0&lt;/b&gt;<br>x &amp; y" in text


def test_sheets_hold_the_pictures_side_by_side(toy_folder, samples, tmp_path):
    written = write_dataset_page(describe(toy_folder), samples, tmp_path / "out")
    assert [path.name for path in written] == ["dataset.html", "samples-grasp.png", "samples-push.png"]
    with Image.open(written[1]) as image:
        sheet = np.asarray(image)
    assert sheet.shape[1] == 2 * 280 + GAP
    np.testing.assert_array_equal(sheet[-240:, :280], samples[0].picture)
    np.testing.assert_array_equal(sheet[-240:, 280 + GAP :], samples[1].picture)


def test_the_same_data_give_the_same_bytes(toy_folder, samples, tmp_path):
    first, second = (
        [path.read_bytes() for path in write_dataset_page(describe(toy_folder), samples, tmp_path / name)]
        for name in ("a", "b")
    )
    assert first == second
