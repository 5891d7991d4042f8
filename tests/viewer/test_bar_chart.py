import pytest
from lxml import etree

from dexnudge.viewer.bar_chart import bar_chart, range_chart


def test_bars_stand_on_each_other_in_proportion_to_their_counts():
    svg = etree.fromstring(bar_chart("a < b", ["0", "1", "2"], {"push": [1, 0, 3], "grasp": [2, 0, 1]}))
    bars = [rect for rect in svg.iter("rect") if "data-count" in rect.attrib]
    assert [(bar.get("data-series"), bar.get("data-count")) for bar in bars] == [
        *(("push", "1"), ("push", "3"), ("grasp", "2"), ("grasp", "1"))
    ]
    unit = float(bars[0].get("height"))
    assert [float(bar.get("height")) / unit for bar in bars] == pytest.approx([1, 3, 2, 1], abs=0.01)
    top_of_first = float(bars[0].get("y"))
    assert float(bars[2].get("y")) + float(bars[2].get("height")) == pytest.approx(top_of_first, abs=0.02)
    assert bars[0].get("x") == bars[2].get("x") != bars[1].get("x")
    assert svg.find("text").text == "a < b"


@pytest.mark.parametrize("series", [{}, {"push": [0, 0]}])
def test_nothing_to_count_is_a_chart_without_bars(series):
    svg = etree.fromstring(bar_chart("empty", ["a", "b"], series))
    assert not [rect for rect in svg.iter("rect") if "data-count" in rect.attrib]


def test_ranges_lie_on_a_common_scale():
    svg = etree.fromstring(range_chart("joints", ["J1", "J2"], [(0.0, 0.5, 1.0), (0.25, 0.3, 0.5)]))
    whole, first, _, second = svg.findall("rect")
    assert float(first.get("x")) == float(whole.get("x"))
    assert float(first.get("width")) == pytest.approx(float(whole.get("width")))
    assert float(second.get("width")) == pytest.approx(float(whole.get("width")) / 4, abs=0.01)
