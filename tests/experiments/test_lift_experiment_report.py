"""Figures of lifts, found by hand."""

import json
from dataclasses import asdict

import pytest

from dexnudge.errors import InputError
from dexnudge.execution.slide_grasp_lift import Attempt
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.lift_experiment import FOLDER, KEPT
from dexnudge.experiments.lift_experiment_lines import lift_lines
from dexnudge.experiments.lift_experiment_report import write_lift_report
from dexnudge.experiments.lift_experiment_rows import LiftRow
from dexnudge.experiments.rows import RowWriter
from dexnudge.jobs.folders import claim_folder
from dexnudge.planning.outcomes import Outcome

SHORT, SUCCESS = Outcome.STOPPED_SHORT, ("", Outcome.SUCCESS)


def row(name, *failures, seconds=1.0, scene="table"):
    """A row whose attempts failed so; SUCCESS is one."""
    tries = [Attempt(number, phase, outcome) for number, (phase, outcome) in enumerate(failures, start=1)]
    return LiftRow(
        object=name,
        scene=scene,
        method="steered_noise",
        status="played",
        seed=0,
        tries=tries,
        simulated=10 * seconds,
        seconds={"draw": seconds, "play": 2 * seconds},
    )


def failed(name, reason):
    return LiftRow(object=name, scene="table", method="steered_noise", status="failed", reason=reason, seed=0)


@pytest.fixture
def rows():
    return [
        row("a", SUCCESS),
        row("b", ("slide", SHORT), SUCCESS, seconds=3.0),
        row("c", ("slide", SHORT), ("lift", Outcome.SLIPPED), seconds=2.0),
        failed("d", "MeshError: no"),
        failed("e", "no draw verified"),
    ]


def test_what_was_attempted_is_the_denominator(rows):
    (line,) = lift_lines(rows)
    assert (line.objects, line.failed, line.unverified) == (5, 1, 1)
    assert (line.lifted.value, line.at_first.value) == (pytest.approx(0.4), pytest.approx(0.2))
    assert line.lifted.low < 0.4 < line.lifted.high
    assert line.failures == {"lift: slipped": 1, "object failed": 1, "no draw verified": 1}
    assert line.first_failures == {"slide: stopped short": 2, "object failed": 1, "no draw verified": 1}
    assert sum(line.failures.values()) == 5 - 2


def test_seconds_and_tries_are_of_what_was_played(rows):
    (line,) = lift_lines(rows)
    means = (line.tries.value, line.draw.value, line.play.value, line.simulated.value)
    assert means == pytest.approx((5 / 3, 2.0, 4.0, 20.0))
    (nothing,) = lift_lines([failed("d", "MeshError: no")])
    assert (nothing.lifted.value, nothing.tries, nothing.play) == (0.0, None, None)


def test_scenes_have_lines_of_their_own(rows):
    lines = lift_lines([*rows, row("a", SUCCESS, scene="shelf")])
    assert [(line.scene, line.objects, line.lifted.value) for line in lines] == [("table", 5, 0.4), ("shelf", 1, 1.0)]


def test_the_report_holds_these_figures(rows, tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        write_lift_report(tmp_path)
    config = {**asdict(ExperimentConfig(objects="some", losses={"sweep": 0.0})), "tries": 2}
    claim_folder(tmp_path / FOLDER, KEPT.file, config, format_version=KEPT.format_version, device="cpu")
    with pytest.raises(InputError, match="holds no lifts yet"):
        write_lift_report(tmp_path)
    writer = RowWriter(tmp_path / FOLDER)
    for each in rows:
        writer.append(each)
    writer.close()
    text = write_lift_report(tmp_path)
    assert (tmp_path / "lifted.md").read_text(encoding="utf-8") == text
    assert "Losses other than each method's own: sweep 0. In one simulation" in text
    assert "lifted by 10 cm and held for 2 s" in text
    assert "comes off within 2 tries" in text
    assert "| table | ours | 5 | 1 | 1 | 40.0 (0-80) | 20.0 (0-60) | 1.7 | 2.0 | 4.0 | 20.0 |" in text
    assert "| scene | method | lift: slipped | object failed | no draw verified |" in text
    (line,) = json.loads((tmp_path / "lifted.json").read_text(encoding="utf-8"))["lines"]
    assert line["lifted"] == {"value": 0.4, "low": 0.0, "high": 0.8}
    assert line["first_failures"]["slide: stopped short"] == 2
