"""Rates with failed objects in the denominator, from rows whose rates are known by hand."""

import json

import pytest

from dexnudge.errors import InputError
from dexnudge.evaluation.experiments import ExperimentConfig, _claim
from dexnudge.evaluation.report import summarise, write_report
from dexnudge.evaluation.rows import Row, RowWriter


def row(name: str, success: list[bool], margin: list[float], own_rank: list[int], **changes) -> Row:
    rejected = {"force": success.count(False)} if False in success else {}
    return Row(
        object=name,
        scene="table",
        method="ours",
        status="sampled",
        num=4,
        seed=0,
        success=success,
        force_margin=margin,
        penetration_mm=[0.0] * 4,
        own_rank=own_rank,
        rejected=rejected,
        seconds={"load": 9.0, "sample": 1.5, "verify": 0.5},
        **changes,
    )


def rows() -> list[Row]:
    return [
        row("a", [True, True, True, False], [3.0, 1.6, 1.2, 2.9], [1, 0, 2, 3]),
        row("b", [True, False, False, False], [1.2, 0.5, 0.5, 0.5], [3, 2, 1, 0]),
        row("c", [False] * 4, [0.5] * 4, [0, 1, 2, 3]),
        Row(object="d", scene="table", method="ours", status="failed", reason="MeshError: no", num=4, seed=0),
    ]


def test_rates_by_hand():
    (line,) = summarise(rows())
    assert (line.objects, line.failed, line.samples) == (4, 1, 16)
    assert line.single.value == pytest.approx(4 / 16)
    assert line.single_robust.value == pytest.approx(2 / 16)  # of a: margins 3.0 and 1.6; 2.9 did not succeed
    assert line.first.value == pytest.approx(1 / 4)  # only a's own first draw succeeds
    assert line.top.value == pytest.approx(2 / 4)
    assert line.top_robust.value == pytest.approx(1 / 4)
    assert line.any.value == pytest.approx(2 / 4)
    assert line.rejected == {"force": 8, "object failed": 4}
    assert sum(line.rejected.values()) + 4 == line.samples
    assert line.seconds == {"load": 9.0, "sample": 1.5, "verify": 0.5}
    assert line.verified_per_second == pytest.approx(4 / 6.0)
    assert line.top.low <= line.top.value <= line.top.high


def test_each_scene_and_method_has_its_line():
    both = [*rows(), row("a", [True] * 4, [2.0] * 4, [0, 1, 2, 3])]
    both[-1] = Row(**{**vars(both[-1]), "method": "unguided"})
    assert [(line.scene, line.method, line.objects) for line in summarise(both)] == [
        ("table", "ours", 4),
        ("table", "unguided", 1),
    ]


def test_files_hold_the_table_and_the_numbers(tmp_path):
    _claim(tmp_path / "out", ExperimentConfig(objects="some", num=4))
    writer = RowWriter(tmp_path / "out")
    for each in rows():
        writer.append(each)
    writer.close()
    text = write_report(tmp_path / "out")
    assert (tmp_path / "out" / "report.md").read_text() == text
    (line,) = [line for line in text.splitlines() if line.startswith("| table | ours | 4 | 1 | 16 | 25.0 (")]
    assert line.endswith("| 0.7 |")
    assert "| table | ours | 8 | 4 |" in text
    content = json.loads((tmp_path / "out" / "report.json").read_text())
    assert content["lines"][0]["single"]["value"] == 0.25
    assert content["config"]["objects"] == "some"
    assert content["versions"]["python"]


def test_no_rows_no_report(tmp_path):
    _claim(tmp_path / "out", ExperimentConfig(objects="some"))
    with pytest.raises(InputError, match="holds no rows yet"):
        write_report(tmp_path / "out")
