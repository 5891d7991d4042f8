"""Reports, from records whose figures are known by hand."""

import csv
import json
import re
from contextlib import closing
from dataclasses import asdict, replace

import numpy as np
import pytest
from PIL import Image

from dexnudge.errors import InputError, OutputError
from dexnudge.experiments import report
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.execution_trial import ExecutionRecord, ExecutionTrial
from dexnudge.experiments.records import RecordWriter
from dexnudge.experiments.report import write_report
from dexnudge.experiments.run import FILE, FORMAT_VERSION
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.experiments.statistics import Estimate
from dexnudge.experiments.tables import csv_text, interval_chart, method_table
from dexnudge.jobs.claims import claim_folder
from dexnudge.sampling.methods import METHODS

SAMPLING = SamplingTrial()


def folder_with(folder, records, **options):
    config = asdict(ExperimentConfig(objects="some", num=4, losses={"sweep": 0.0})) | options
    claim_folder(folder, FILE, config, format_version=FORMAT_VERSION, device="cpu")
    with closing(RecordWriter(folder)) as writer:
        for record in records:
            writer.append(record)


@pytest.fixture
def out(tmp_path, four_records):
    folder_with(tmp_path / "out", four_records)
    return tmp_path / "out"


def test_what_failed_and_what_was_repaired_is_said_once_for_each_object(tmp_path, sampled, four_records):
    repaired = sampled("e", [True] * 4, [2.0] * 4, repairs=["2 of 12 faces stood there twice and count once"])
    folder_with(tmp_path / "out", [*four_records, repaired])
    text = write_report(SAMPLING, tmp_path / "out")
    assert "## Objects that failed\n\n- d: MeshError: no\n" in text
    assert "repaired when they were read\n\n- e: 2 of 12 faces stood there twice and count once\n" in text


def test_text_numbers_and_table_hold_the_same_figures(out):
    text = write_report(SAMPLING, out)
    assert (out / "report.md").read_text() == text
    assert "4 draws of each trial, seed 0, hand shadow_lite, dexnudge " in text
    assert "Losses other than each method's own: sweep 0." in text
    (line,) = [line for line in text.splitlines() if line.startswith("| table | steered_noise | 4 | 1 | 16 | 25.0 (")]
    assert re.search(r"\| 0\.7 \(\d\.\d-\d\.\d\) \|$", line)
    assert "| table | steered_noise | 8 | 4 |" in text  # rejected by force, and of the failed object
    content = json.loads((out / "report.json").read_text())
    (row,) = content["metrics"]
    assert (row["single"]["value"], row["rejected"]) == (0.25, {"force": 8, "object failed": 4})
    assert content["config"]["num"] == 4
    with (out / "report.csv").open() as file:
        (cells,) = csv.DictReader(file)
    assert (cells["scene"], cells["method"], cells["objects"], cells["single"]) == (
        "table",
        "steered_noise",
        "4",
        "0.25",
    )
    assert float(cells["single_low"]) == pytest.approx(row["single"]["low"], rel=1e-5)
    assert cells["rejected.force"] == "8"


def test_the_order_in_which_trials_finished_does_not_matter(out, tmp_path, four_records):
    records = [*four_records, *(replace(each, scene="shelf") for each in four_records)]
    folder_with(tmp_path / "one", records)
    folder_with(tmp_path / "other", records[::-1])
    assert write_report(SAMPLING, tmp_path / "one") == write_report(SAMPLING, tmp_path / "other")


def test_charts_are_drawn_and_named(out):
    text = write_report(SAMPLING, out)
    assert "![Rates](rates.png)" in text
    assert np.asarray(Image.open(out / "rates.png")).std() > 10


def test_without_matplotlib_the_report_says_what_to_install(out, monkeypatch):
    monkeypatch.setattr(report, "AVAILABLE", False)
    text = write_report(SAMPLING, out)
    assert "Charts need matplotlib: `pip install 'dexnudge[plots]'`." in text
    assert "rates.png" not in text
    assert not (out / "rates.png").exists()


def test_a_folder_without_records_or_without_an_experiment_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file; expected the file that `dexnudge evaluate`"):
        write_report(SAMPLING, tmp_path)
    folder_with(tmp_path / "out", [])
    with pytest.raises(InputError, match="holds no records yet"):
        write_report(SAMPLING, tmp_path / "out")


def test_a_report_that_cannot_be_written_is_refused(out):
    (out / "report.json").mkdir()
    with pytest.raises(OutputError, match="cannot write the report into"):
        write_report(SAMPLING, out)


def test_executions_have_lengths_beside_their_rates_and_a_calibration(out, executed):
    played = ExecutionRecord(
        object="a", scene="table", method="steered_noise", seed=0, num=4, verified=2, executed=[executed(0, 3.0)]
    )
    folder_with(out / "executed", [played, replace(played, object="b", executed=[executed(0, 1.3, "dropped")])])
    text = write_report(ExecutionTrial(), out)
    assert "| scene | method | objects | failed | unverified | top-ranked | length asked, mm | reached, mm |" in text
    assert (
        "| table | steered_noise | 2 | 0 | 0 | 50.0 (0-100) | 100 (100-100) | 90 (90-90) | 2 | 50.0 (0-100) |" in text
    )
    assert "| 3 (cap) | 100.0 (100-100), n = 1 | 100.0 (100-100), n = 1 |" in text
    assert (out / "executed" / "calibration.png").exists()
    bins = json.loads((out / "executed" / "report.json").read_text())["sections"]["By force margin"]["all"]
    assert bins["3 (cap)"] == {"number": 1, "objects": 1, "rate": {"value": 1.0, "low": 1.0, "high": 1.0}}
    assert "drawn otherwise" not in text


def test_draws_that_are_not_those_of_the_experiment_are_counted(out):
    other = ExecutionRecord(object="a", scene="table", method="steered_noise", seed=0, num=4, verified=1)
    folder_with(out / "executed", [other])
    assert "1 trials drew otherwise than the experiment's own, as another machine or version does." in write_report(
        ExecutionTrial(), out
    )


def test_each_method_is_explained_once():
    lines = method_table(["steered_noise", "unguided", "steered_noise"]).markdown().splitlines()
    assert lines[2:] == [f"| {name} | {METHODS[name].summary} |" for name in ("steered_noise", "unguided")]


def test_infinite_and_missing_numbers_are_empty_cells():
    text = csv_text([{"a": Estimate(1.0, 0.5, np.inf), "b": None}, {"a": Estimate(1.0, 1.0, 1.0), "b": {"x": 2}}])
    assert text == "a,a_low,a_high,b,b.x\n1,0.5,,,\n1,1,1,,2\n"


class TestCharts:
    """What is drawn, read from matplotlib's own objects."""

    def test_bars_and_lines_are_as_long_as_their_numbers(self):
        groups = {
            "one": {"a": Estimate(0.8, 0.7, 0.9), "b": Estimate(0.0, 0.0, 0.0)},
            "two": {"a": Estimate(1.0, 0.4, 1.0)},
        }
        (axes,) = interval_chart("Rates", groups).axes
        assert [bar.get_width() for bar in axes.patches] == pytest.approx([80.0, 0.0, 100.0])
        assert [tuple(line.get_xdata()) for line in axes.lines] == [(70.0, 90.0), (0.0, 0.0), (40.0, 100.0)]
        assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b", "a"]
        assert axes.get_xlim() == (0.0, 100.0)

    def test_a_calibration_has_a_bar_for_each_bin_that_has_outcomes_and_their_number(self, executed):
        draws = [executed(0, 1.1), executed(1, 1.2, "dropped"), executed(2, 3.0)]
        one = ExecutionRecord(object="a", scene="table", method="steered_noise", seed=0, num=4, executed=draws)
        _, draw = ExecutionTrial().sections([one])[0].chart
        (axes,) = draw().axes
        assert [bar.get_width() for bar in axes.patches] == [50.0, 100.0]
        assert [label.get_text() for label in axes.get_yticklabels()] == ["1 to 1.25, n = 2", "3 (cap), n = 1"]
