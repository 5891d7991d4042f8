"""Bars and intervals are as long as their numbers."""

from xml.etree import ElementTree

import numpy as np
import pytest

from dexnudge.experiments.interval_chart import interval_chart
from dexnudge.experiments.statistics import Estimate

SVG = "{http://www.w3.org/2000/svg}"
GROUPS = {
    "table <1>": {"ours & others": Estimate(0.8, 0.7, 0.9), "none": Estimate(0.0, 0.0, 0.0)},
    "shelf": {"ours & others": Estimate(0.4, 0.1, 0.5)},
}


def parts(svg):
    root = ElementTree.fromstring(svg)  # noqa: S314  our own text
    bars = [rect for rect in root.iter(f"{SVG}rect") if rect.get("data-value")]
    return root, bars, [line for line in root.iter(f"{SVG}line") if line.get("stroke-width")]


def test_lengths_are_proportional_to_the_numbers():
    _, bars, intervals = parts(interval_chart("Rates", GROUPS, limit=1.0, factor=100.0))
    assert [float(bar.get("data-value")) for bar in bars] == [0.8, 0.0, 0.4]
    widths = [float(bar.get("width")) for bar in bars]
    assert widths[1] == 0.0
    assert widths[0] == pytest.approx(2 * widths[2], abs=0.02)
    unit, left = widths[0] / 0.8, float(bars[0].get("x"))
    for line, (low, high) in zip(intervals, [(0.7, 0.9), (0.0, 0.0), (0.1, 0.5)], strict=True):
        assert float(line.get("x1")) == pytest.approx(left + low * unit, abs=0.02)
        assert float(line.get("x2")) == pytest.approx(left + high * unit, abs=0.02)
    assert bars[0].get("fill") != bars[2].get("fill")


def test_names_and_numbers_stand_beside_the_bars():
    root, _, _ = parts(interval_chart("Rates [%]", GROUPS, factor=100.0))
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert texts[0] == "Rates [%]"
    assert {"table <1>", "ours & others", "80.0 (70.0-90.0)", "40.0 (10.0-50.0)"} <= set(texts)


def test_the_scale_has_its_numbers_where_bars_of_that_length_end():
    root, bars, _ = parts(interval_chart("Rates [%]", GROUPS, limit=1.0, factor=100.0))
    left, unit = float(bars[0].get("x")), float(bars[0].get("width")) / 0.8
    ticks = {text.text: float(text.get("x")) for text in root.iter(f"{SVG}text") if text.get("class") == "scale"}
    for number in (0, 25, 50, 75, 100):
        assert ticks[str(number)] == pytest.approx(left + 0.01 * number * unit, abs=0.05)


@pytest.mark.parametrize(("greatest", "last"), [(15.6, "20"), (8.0, "8"), (0.31, "0.4"), (99.0, "100")])
def test_a_scale_without_a_limit_ends_at_a_round_number(greatest, last):
    root, _, _ = parts(interval_chart("Rates", {"one": {"a": Estimate(greatest, greatest, greatest)}}))
    ticks = [text.text for text in root.iter(f"{SVG}text") if text.get("class") == "scale"]
    assert ticks[4] == last


def test_names_of_any_length_have_room():
    name = "a name as long as this one is, and then some more of it"
    root, bars, _ = parts(interval_chart("Rates", {"one": {name: Estimate(0.5, 0.4, 0.6)}}))
    assert float(bars[0].get("x")) > 6.0 * len(name)
    assert float(root.get("width")) > float(bars[0].get("x")) + float(bars[0].get("width"))


def test_nothing_reaches_beyond_the_chart():
    bars = {"one": {"fast": Estimate(2.0, 1.0, np.inf), "endless": Estimate(np.inf, 1.0, np.inf)}}
    root, found, lines = parts(interval_chart("Rates", bars))
    width = float(root.get("width"))
    assert all(float(bar.get("x")) + float(bar.get("width")) <= width for bar in found)
    assert all(float(line.get("x2")) <= width for line in lines)
    assert float(root.get("height")) > max(float(bar.get("y")) + float(bar.get("height")) for bar in found)
