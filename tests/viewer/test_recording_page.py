import base64
import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dexnudge.errors import InputError, OutputError
from dexnudge.viewer.page import NAME_WIDTH, recording_charts, write_recording_page
from dexnudge.viewer.recording import Curve

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"q\" 'r' $title"


def data_of(path):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', path.read_text())[1])


@pytest.fixture(scope="module")
def page(recording, tmp_path_factory):
    return write_recording_page(recording, tmp_path_factory.mktemp("recording") / "film.html")


def test_the_page_loads_nothing_from_anywhere(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"https?:|url\(|@import|import\s*\(|fetch\(|XMLHttpRequest|\ssrc=|href=", text)
    assert "default-src 'none'" in text


def test_frames_are_those_of_the_recording(page, recording):
    data = data_of(page)
    assert len(data["configurations"]) == len(data["time"]) == len(data["phase"]) == len(data["arrows"]) == 41
    for entry, frame in zip(data["configurations"], recording.frames, strict=True):
        poses = np.frombuffer(base64.b64decode(entry["poses"]), dtype="<f4").reshape(-1, 3, 4)
        np.testing.assert_allclose(poses, [part.T_world_part[:3] for part in frame.parts], atol=1e-7)
    np.testing.assert_allclose(data["time"], recording.time, atol=1e-4)


def test_the_arrow_is_there_as_long_as_the_object_shall_move(page, recording):
    assert data_of(page)["arrows"] == [True] * 31 + [False] * 10


def test_numbers_beside_are_those_of_the_curves(page, recording):
    along, up, normal = data_of(page)["curves"]
    np.testing.assert_allclose(along["values"], recording.charts["way"][0].values, atol=1e-4)
    assert normal["values"][:20] == [None] * 20
    assert normal["values"][20] == pytest.approx(4.0)
    assert (along["unit"], normal["unit"]) == ("mm", "N")
    assert set(up["values"]) == {0.0}


def test_lines_are_drawn_where_the_axis_says(page):
    found = re.findall(r"<svg.*?</svg>", page.read_text(encoding="utf-8"), re.DOTALL)
    chart, force = (ElementTree.fromstring(svg) for svg in found)  # noqa: S314  our own
    ticks = {
        float(text.text): float(line.get("y1"))
        for line, text in zip(chart.findall("line[@class='grid']"), chart.findall("text[@class='tick']"), strict=True)
    }
    assert sorted(ticks) == [0, 50, 100]
    corners = np.array([point.split(",") for point in chart.find("polyline").get("points").split()], dtype=float)
    values = 100 * (ticks[0] - corners[:, 1]) / (ticks[0] - ticks[100])
    left, width = float(chart.get("data-left")), float(chart.get("data-width"))
    moments = 2.0 * (corners[:, 0] - left) / width
    np.testing.assert_allclose(values, 100 * np.maximum(moments - 1, 0), atol=0.2)
    assert len(force.find("polyline").get("points").split()) == 21


def test_hostile_names_are_shown_and_not_run(recording, tmp_path):
    hostile = replace(
        recording, title=HOSTILE, subtitle=HOSTILE, phase=[HOSTILE] * 41, charts={HOSTILE: recording.charts["way"]}
    )
    text = write_recording_page(hostile, tmp_path / "film.html").read_text(encoding="utf-8")
    assert text.count("<script") == 2
    assert "<img" not in text


def test_a_long_recording_is_thinned(recording, tmp_path):
    many = recording.part(np.arange(41).repeat(50))
    many = replace(many, time=np.linspace(0.0, 41.0, 2050))
    data = data_of(write_recording_page(many, tmp_path / "film.html"))
    assert len(data["time"]) == len(data["configurations"]) == 1000
    assert (data["time"][0], data["time"][-1]) == (0.0, 41.0)


def test_what_cannot_be_shown_or_written_is_refused(recording, tmp_path):
    fewer = replace(recording.frames[1], parts=recording.frames[1].parts[:2])
    with pytest.raises(InputError, match="visual scene 1 shows other bodies"):
        replace(recording, frames=[recording.frames[0], fewer, *recording.frames[2:]])
    with pytest.raises(OutputError, match="cannot write"):
        write_recording_page(recording, tmp_path / "missing" / "film.html")


def test_short_phases_are_named_too_and_names_do_not_meet(recording):
    """Five phases, two of them a frame long and next to each other: each is named, and two names in a row keep apart."""
    names = ["pre-contact"] * 18 + ["contact", "squeeze"] + ["push"] * 10 + ["retreat"] * 11
    (chart,) = recording_charts(replace(recording, phase=names, charts={"way": recording.charts["way"]}))
    found = re.findall(r'<text x="([\d.]+)" y="([\d.]+)" class="phase">([^<]+)', chart)
    assert [name for _, _, name in found] == list(dict.fromkeys(names))
    for row in {y for _, y, _ in found}:
        placed = [(float(x), NAME_WIDTH * len(name) / 2) for x, y, name in found if y == row]
        assert all(x + half <= other - its + 0.1 for (x, half), (other, its) in pairwise(placed))


def test_every_curve_of_a_crowded_chart_has_its_line_its_name_and_its_reading(recording):
    """As many curves as a hand has links: each in a colour of its own, the names inside the chart and apart."""
    fingers = tuple(Curve(f"{finger}distal", "N", recording.time) for finger in ("ff", "mf", "rf", "lf", "th", "palm"))
    curves = (*fingers, Curve("limit", "N", np.full(len(recording.time), 5.0), limit=True))
    (chart,) = recording_charts(replace(recording, charts={"links on object": curves}))
    lines = re.findall(r'<polyline [^>]*stroke="([^"]+)" class="curve"( stroke-dasharray)?', chart)
    names = re.findall(r'<text x="(\d+)" y="([\d.]+)" fill="([^"]+)">(\w+) <tspan data-value=""></tspan>', chart)
    assert [name for *_, name in names] == [curve.name for curve in curves]
    assert [colour for _, _, colour, _ in names] == [colour for colour, _ in lines]
    assert len({colour for colour, _ in lines}) == len(curves)
    assert [bool(dashed) for _, dashed in lines] == [curve.limit for curve in curves]
    width, height = map(float, re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', chart)[0])
    for (x, y, _, name), following in zip(names, [*names[1:], None], strict=True):
        end = float(x) + 6 * len(name) + 40  # a reading such as "12.3 N"
        assert end <= width
        assert following is None or following[1] != y or end <= float(following[0])
    top = float(re.findall(r'<rect x="[\d.]+" y="([\d.]+)"', chart)[0])
    assert all(float(y) < top < height for _, y, _, _ in names)
