"""The report of an experiment, from rows whose rates are known by hand."""

import json
import re
from dataclasses import asdict

import pytest

from dexnudge.errors import InputError
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.experiments import FILE, FORMAT_VERSION
from dexnudge.experiments.report import write_report
from dexnudge.experiments.rows import RowWriter
from dexnudge.jobs.folders import claim_folder


@pytest.fixture
def folder(tmp_path):
    """The folder of an experiment that has no rows yet."""
    config = asdict(ExperimentConfig(objects="some", num=4))
    claim_folder(tmp_path / "out", FILE, config, format_version=FORMAT_VERSION, device="cpu")
    return tmp_path / "out"


def test_files_hold_the_table_and_the_numbers(folder, made_up_rows):
    writer = RowWriter(folder)
    for each in made_up_rows:
        writer.append(each)
    writer.close()
    text = write_report(folder)
    assert (folder / "report.md").read_text() == text
    (line,) = [line for line in text.splitlines() if line.startswith("| table | dexnudge | 4 | 1 | 16 | 25.0 (")]
    assert re.search(r"\| 0\.7 \(\d\.\d-\d\.\d\) \|$", line)
    assert "| dexnudge | `ours` | " in text
    assert "| table | dexnudge | 8 | 4 |" in text
    content = json.loads((folder / "report.json").read_text())
    assert content["lines"][0]["single"]["value"] == 0.25
    assert content["config"]["objects"] == "some"
    assert content["versions"]["python"]


def test_other_losses_stand_at_the_head(tmp_path, made_up_rows):
    config = asdict(ExperimentConfig(objects="some", num=4, losses={"sweep": 0.0, "clearance_base": 0.02}))
    claim_folder(tmp_path / "out", FILE, config, format_version=FORMAT_VERSION, device="cpu")
    writer = RowWriter(tmp_path / "out")
    writer.append(made_up_rows[0])
    writer.close()
    head = write_report(tmp_path / "out").split("\n|")[0]
    assert "Losses other than each method's own: sweep 0, clearance_base 0.02. Rates in %" in head


def test_no_rows_no_report(folder):
    with pytest.raises(InputError, match="holds no rows yet"):
        write_report(folder)
