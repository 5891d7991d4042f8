"""Figures of executions, found by hand."""

import json
import re

import pytest

from dexnudge.errors import InputError
from dexnudge.experiments import execution_experiment as experiment
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.execution_experiment import run_executions
from dexnudge.experiments.experiment_lines import (
    CAPPED,
    calibration,
    changed_rates,
    executed_lines,
    grouped,
    margin_bin,
    margin_bins,
)
from dexnudge.experiments.experiment_report import write_execution_report
from dexnudge.experiments.experiment_rows import ExecutionRow
from dexnudge.experiments.rows import Row, RowWriter

CHANGED = {"mass x 0.5": True, "mass x 1.5": False}


def row(name, configurations=(), *, scene="table", status="executed"):
    return ExecutionRow(
        object=name, scene=scene, method="steered_noise", status=status, seed=0, configurations=list(configurations)
    )


@pytest.fixture
def rows(executed):
    return [
        row("a", [executed(0, 3.0, changed=CHANGED), executed(1, 2.7, "fell short", links=1)]),
        row("b", [executed(0, 1.6, "turned", behaviour="press", changed=CHANGED), executed(1, 1.0)]),
        row("c"),
        row("d", status="failed"),
    ]


def test_what_was_attempted_is_the_denominator(rows):
    (line,) = executed_lines(rows)
    assert (line.objects, line.failed, line.unverified, line.executed) == (4, 1, 1, 4)
    assert line.top.value == pytest.approx(0.25)
    assert (line.top.low, line.top.high) == (0.0, 0.75)
    assert line.single.value == pytest.approx(0.5)
    assert line.failures == {"fell short": 1, "turned": 1, "object failed": 1, "no draw verified": 1}


def test_margins_fall_into_their_bins():
    assert margin_bins() == ["1 to 1.25", "1.25 to 1.5", "1.5 to 2", "2 to 2.5", "2.5 to 3", CAPPED]
    assert [margin_bin(m) for m in (1.0, 1.249, 1.25, 1.9, 2.0, 2.999, 3.0)] == [
        "1 to 1.25",
        "1 to 1.25",
        "1.25 to 1.5",
        "1.5 to 2",
        "2 to 2.5",
        "2.5 to 3",
        CAPPED,
    ]


def test_calibration_counts_every_executed_configuration_once(rows):
    found = calibration(rows)
    assert list(found) == ["all", "table"]
    assert {label: (group.executed, group.rate.value) for label, group in found["all"].items()} == {
        "1 to 1.25": (1, 1.0),
        "1.5 to 2": (1, 0.0),
        "2.5 to 3": (1, 0.0),
        CAPPED: (1, 1.0),
    }


def test_an_object_is_resampled_with_all_its_configurations(rows, executed):
    """Of two objects with 1 of 2 successes each, every resample has the same rate; of (2 of 2, 0 of 2) it has not."""
    (even,) = grouped(rows, lambda _: "all").values()
    assert (even.executed, even.objects, even.rate.low, even.rate.high) == (4, 2, 0.5, 0.5)
    uneven = [row("a", [executed(0, 2.0), executed(1, 2.0)]), row("b", [executed(k, 2.0, "dropped") for k in (0, 1)])]
    (group,) = grouped(uneven, lambda _: "all").values()
    assert (group.rate.value, group.rate.low, group.rate.high) == (0.5, 0.0, 1.0)


def test_errors_are_rated_over_what_was_played_with_them(rows):
    rates = {name: (group.executed, group.rate.value) for name, group in changed_rates(rows).items()}
    assert rates == {"as planned": (2, 0.5), "mass x 0.5": (2, 1.0), "mass x 1.5": (2, 0.0)}
    assert changed_rates([row("c")]) == {}


def test_the_report_holds_these_figures(rows, executed, tmp_path, monkeypatch):
    class Made:
        def __init__(self, *_, **__):
            self.rows = {made.object: made for made in rows}

        def __call__(self, task):
            return self.rows.get(task.object, row(task.object, [executed(0, 2.2)]))

    monkeypatch.setattr(experiment, "ExecutionRowMaker", Made)
    names = {"a", "b", "c", "d"}
    (tmp_path / "objects").mkdir()
    for name in names:
        (tmp_path / "objects" / f"{name}.obj").write_text("")
    config = ExperimentConfig(objects=str(tmp_path / "objects"), scenes=("table",), num=4, losses={"sweep": 0.0})
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        write_execution_report(out)
    run_executions(config, out, num=2, errors=True, workers=1)
    text = write_execution_report(out)
    assert "Losses other than each method's own: sweep 0. Top-ranked:" in text
    assert "| table | ours | 4 | 1 | 1 | 25.0 (0-75) | 4 | 50.0 (50-50) |" in text
    assert "| 3 (cap) | 100.0 (100-100), n = 1 | 100.0 (100-100), n = 1 |" in text
    assert "| mass x 1.5 | 0.0 (0-0), n = 2 | 0.0 (0-0), n = 2 |" in text
    assert "drawn otherwise" not in text
    assert (out / "executed.md").read_text(encoding="utf-8") == text
    numbers = json.loads((out / "executed.json").read_text(encoding="utf-8"))
    assert numbers["lines"][0]["top"]["value"] == 0.25
    assert numbers["calibration"]["all"][CAPPED] == {
        "executed": 1,
        "objects": 1,
        "rate": {"value": 1.0, "low": 1.0, "high": 1.0},
    }
    chart = (out / "calibration.svg").read_text(encoding="utf-8")
    assert re.findall(r'data-rate="([^"]*)"', chart) == ["1", "0", "0", "1"]

    writer = RowWriter(out)
    common = {
        "scene": "table",
        "method": "steered_noise",
        "status": "sampled",
        "num": 4,
        "seed": 0,
        "success": [True] * 4,
    }
    writer.append(Row(object="a", force_margin=[3.0, 2.7, 1.0, 1.0], **common))
    writer.append(Row(object="b", force_margin=[2.9, 1.0, 1.0, 1.0], **common))
    writer.close()
    assert "1 rows were drawn otherwise" in write_execution_report(out)
