"""`benchmarks/publish.py` writes the pages from the reports of either command."""

import csv
import importlib.util
import json
import sys
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import yaml

from dexnudge.cli.main import main
from dexnudge.experiments.arm_trial import ArmRecord, ArmTrial
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.execution_trial import ExecutionRecord, ExecutionTrial
from dexnudge.experiments.records import RecordWriter
from dexnudge.experiments.report import write_report
from dexnudge.experiments.run import FILE, FORMAT_VERSION
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.jobs.claims import claim_folder
from dexnudge.trajectories.planner import Failure

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "publish.py"
README = "before\n<!-- results:begin -->\nold\n<!-- results:end -->\n<!-- hands:begin -->\n<!-- hands:end -->\nafter\n"


@pytest.fixture(scope="module")
def publish():
    spec = importlib.util.spec_from_file_location("publish", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["publish"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def root(tmp_path):
    root = tmp_path / "repository"
    (root / "docs").mkdir(parents=True)
    (root / "README.md").write_text(README)
    return root


@pytest.fixture
def runs(tmp_path, four_records, executed):
    """The run "test42", and "executed" with executions in it."""
    for name in ("test42", "executed"):
        methods = ("steered_noise", "random_start_projection")
        config = asdict(ExperimentConfig(objects="a/some.txt", scenes=("table",), methods=methods, num=4))
        claim_folder(tmp_path / "runs" / name, FILE, config, format_version=FORMAT_VERSION, device="cpu")
        with closing(RecordWriter(tmp_path / "runs" / name)) as writer:
            for record in [*four_records, *(replace(each, method="random_start_projection") for each in four_records)]:
                writer.append(record)
        write_report(SamplingTrial(), tmp_path / "runs" / name)
    claim_folder(tmp_path / "runs/executed/executed", FILE, config, format_version=FORMAT_VERSION, device="cpu")
    with closing(RecordWriter(tmp_path / "runs/executed/executed")) as writer:
        common = {"scene": "table", "method": "steered_noise", "seed": 0, "num": 4, "verified": 1}
        writer.append(ExecutionRecord(object="a", executed=[executed(0, 3.0)], **common))
        writer.append(ExecutionRecord(object="b", executed=[executed(0, 1.2, "turned")], **common))
    write_report(ExecutionTrial(), tmp_path / "runs" / "executed")
    return tmp_path / "runs"


def test_tables_say_what_they_were_made_with_and_pages_are_made_from_them(publish, root, runs):
    publish.Publish(("test42", "executed"), folder=runs, root=root, only_write=True).run()
    with (root / "docs" / "data" / "test42.csv").open() as file:
        rows = list(csv.DictReader(file))
    report = json.loads((runs / "test42" / "report.json").read_text())
    assert [(row["scene"], row["method"]) for row in rows] == [
        ("table", "steered_noise"),
        ("table", "random_start_projection"),
    ]
    assert (rows[0]["objects"], rows[0]["set"], rows[0]["draws_each"], rows[0]["seed"]) == ("4", "some.txt", "4", "0")
    assert rows[0]["version"] == report["versions"]["dexnudge"]
    assert report["machine"]["processor"] in rows[0]["machine"]
    assert float(rows[0]["single"]) == report["metrics"][0]["single"]["value"]
    readme = (root / "README.md").read_text()
    assert readme.startswith("before\n<!-- results:begin -->\n| scene |")
    assert readme.endswith("<!-- results:end -->\n<!-- hands:begin -->\nNone.\n<!-- hands:end -->\nafter\n")
    assert "| table | random start + projection | 25.0 (" in readme
    assert "4 objects of `some.txt`, 4 draws each, seed 0, dexnudge " in readme
    results = (root / "docs" / "results.md").read_text()
    assert "| top-ranked executed in physics, % | 50.0 (0–100) |" in results
    assert "| length asked for, mm | 100 (100–100) |" in results
    assert "| table | dexnudge | 50.0 (0–100) | 100 (100–100) | 90 (90–90) |" in results
    pictures = {part.split(")")[0] for part in results.split("](images/")[1:]}
    assert pictures == {"executed-executed-calibration.png"}
    assert pictures <= {file.name for file in (root / "docs" / "images").iterdir()}
    with (root / "docs" / "data" / "executed-executed-by-force-margin.csv").open() as file:
        bins = {(row["scenes"], row["group"]): row["rate"] for row in csv.DictReader(file)}
    assert (bins["all", "3 (cap)"], bins["table", "1 to 1.25"]) == ("1", "0")


def test_arms_have_a_table_on_the_page_and_in_a_readme_that_has_room_for_it(publish, root, tmp_path):
    out = tmp_path / "runs" / "arm"
    config = asdict(ExperimentConfig(objects="a/some.txt", scenes=("table",), num=4))
    claim_folder(out / "arm", FILE, config, format_version=FORMAT_VERSION, device="cpu")
    common = {"scene": "table", "method": "steered_noise", "seed": 0, "num": 4, "verified": 1}
    planned = {"limits": dict.fromkeys(("position", "velocity", "acceleration", "jerk"), 0.5)}
    planned |= {"penetration_mm": {"object": 0.25, "environment": 0.0, "self_collision": 0.04}, "configuration": 0}
    with closing(RecordWriter(out / "arm")) as writer:
        writer.append(
            ArmRecord(object="a", outcome="success", palm_error_mm=2.0, **planned, seconds={"plan": 3.0}, **common)
        )
        writer.append(ArmRecord(object="b", failures=[Failure(0, "push", "no")], seconds={"plan": 5.0}, **common))
    write_report(ArmTrial("panda"), out.parent / "arm")
    (root / "README.md").write_text(README + "<!-- arm:begin -->\n<!-- arm:end -->\n")
    publish.Publish(("arm",), folder=tmp_path / "runs", root=root, only_write=True).run()
    row = "| panda | table | 50.0 (0–100) | 3.0 (3.0–5.0) | 5.0 (3.0–5.0) | 50.0 (0–100) | 100.0 (100–100) | 2.0 | "
    for page in ("README.md", "docs/results.md"):
        text = (root / page).read_text()
        assert f"{row}0.50/0.50/0.50/0.50 | 0.2/0.0/0.0 |\n" in text
        assert "Without success: table: no plan: push 1." in text
    table = (root / "README.md").read_text().partition("<!-- arm:begin -->\n")[2].partition("<!-- arm:end -->")[0]
    assert len(table.splitlines()) == 5


def test_one_run_is_published_anew_without_the_folders_of_the_others(publish, root, runs):
    publish.Publish(("test42", "executed"), folder=runs, root=root, only_write=True).run()
    before = (root / "docs" / "results.md").read_text()
    publish.Publish(folder=runs / "nowhere", root=root).run()
    assert (root / "docs" / "results.md").read_text() == before


def test_a_run_that_is_not_listed_is_refused(publish, root, runs):
    with pytest.raises(SystemExit, match="no published run is called 'test43'; expected some of test42, "):
        publish.Publish(("test43",), folder=runs, root=root).run()


def test_every_published_command_is_one_that_the_command_line_takes(publish, tmp_path, capsys, monkeypatch):
    """Each gets as far as looking for its objects."""
    monkeypatch.chdir(tmp_path)
    for name, run in yaml.safe_load(publish.RUNS.read_text()).items():
        command = run["command"].replace("builtin:test", "nowhere.txt").split()
        command += ["--objects", "nowhere.txt"] if "--objects" not in command else []
        assert main([*command, "--out", str(tmp_path / "out")]) == 2, name
        assert "no such set of objects" in capsys.readouterr().err, name


def test_the_published_page_is_short():
    page = SCRIPT.parents[1] / "docs" / "results.md"
    assert len(page.read_text(encoding="utf-8").splitlines()) <= 150
