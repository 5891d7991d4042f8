"""`benchmarks/publish.py` writes the pages from the reports of either command."""

import importlib.util
import json
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from dexnudge.experiments import reproduction_report
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.experiments import FILE, FORMAT_VERSION
from dexnudge.experiments.report import write_report
from dexnudge.experiments.reproduction import FILE as REPRODUCTION_FILE
from dexnudge.experiments.reproduction import FORMAT_VERSION as REPRODUCTION_VERSION
from dexnudge.experiments.reproduction_parts import ReproductionConfig, parts
from dexnudge.experiments.reproduction_report import write_reproduction_report
from dexnudge.experiments.rows import RowWriter
from dexnudge.jobs.folders import claim_folder

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "publish.py"
README = "before\n<!-- results:begin -->\nold\n<!-- results:end -->\nafter\n"
STEERED_NOISE = "| table | dexnudge | 25.0 ("  # of the made-up rows


@pytest.fixture(scope="module")
def publish_module():
    spec = importlib.util.spec_from_file_location("publish", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def publish(publish_module):
    return publish_module.Publish


@pytest.fixture
def root(tmp_path):
    root = tmp_path / "repository"
    (root / "docs").mkdir(parents=True)
    (root / "README.md").write_text(README)
    return root


@pytest.fixture
def evaluated(tmp_path, made_up_rows):
    folder = tmp_path / "evaluated"
    config = asdict(ExperimentConfig(objects="some", scenes=("table",), num=4))
    claim_folder(folder, FILE, config, format_version=FORMAT_VERSION, device="cpu")
    with closing(RowWriter(folder)) as writer:
        for row in made_up_rows:
            writer.append(row)
    write_report(folder)
    return folder


@pytest.fixture
def reproduced(tmp_path, made_up_rows, monkeypatch):
    """Without the forearm nothing succeeds, so that the README's table shows which part it is made from."""
    folder = tmp_path / "reproduced"
    objects = tmp_path / "objects"
    objects.mkdir()
    for row in made_up_rows:
        (objects / f"{row.object}.obj").write_text("")
    config = ReproductionConfig(objects=str(objects), scenes=("table",), num=4, quick=True)
    claim_folder(folder, REPRODUCTION_FILE, config.as_json(), format_version=REPRODUCTION_VERSION, device="cpu")
    for part in parts(config):
        claim_folder(folder / part.folder, FILE, asdict(part.config), format_version=FORMAT_VERSION, device="cpu")
        with closing(RowWriter(folder / part.folder)) as writer:
            for method in part.config.methods:
                for row in made_up_rows:
                    success = row.success if part.config.base else [False] * len(row.success)
                    writer.append(replace(row, method=method, success=success))
    monkeypatch.setattr(reproduction_report, "picture_rejected", lambda cases, folder: [None] * len(cases))
    write_reproduction_report(folder)
    return folder


def test_a_run_of_evaluate(publish, root, evaluated):
    publish((evaluated,), root=root).run()
    readme = (root / "README.md").read_text()
    assert readme.startswith("before\n<!-- results:begin -->\n| scene |")
    assert readme.endswith("<!-- results:end -->\nafter\n")
    assert STEERED_NOISE in readme
    assert "4 objects of `some`, 4 draws each, seed 0" in readme
    assert (root / "docs" / "results.md").read_text() == (evaluated / "report.md").read_text()


def test_a_run_of_reproduce_with_its_plots(publish, root, reproduced, evaluated):
    publish((reproduced, evaluated), root=root).run()
    readme = (root / "README.md").read_text()
    assert STEERED_NOISE in readme
    assert "| table | random start + projection | 25.0 (" in readme
    results = (root / "docs" / "results.md").read_text()
    assert "](plots/" not in results
    assert "](images/reproduced-with_base-single.svg)" in results
    assert results.endswith((evaluated / "report.md").read_text())
    titles = [line.removeprefix("# ") for line in results.splitlines() if line.startswith("# ")]
    assert [line.split("](")[0].removeprefix("- [") for line in results.splitlines()[:2]] == titles
    copied = root / "docs" / "images" / "reproduced-with_base-single.svg"
    assert copied.read_bytes() == (reproduced / "plots" / "with_base-single.svg").read_bytes()
    shown = {part.split(")")[0] for part in results.split("](images/")[1:]}
    assert shown == {file.name for file in (root / "docs" / "images").iterdir()}


def test_rates_in_physics_stand_beside_the_others(publish, root, evaluated, tmp_path):
    runs = tmp_path / "physics", tmp_path / "elsewhere"
    for run, value in zip(runs, (0.625, 0.125), strict=True):
        run.mkdir()
        top = {"value": value, "low": 0.5, "high": 0.75}
        (run / "executed.json").write_text(
            json.dumps({"lines": [{"scene": "table", "method": "steered_noise", "top": top}]})
        )
        (run / "executed.md").write_text(f"# Executed {value}\n\n![calibration](calibration.svg)\n")
        (run / "calibration.svg").write_text(f"<svg>{value}</svg>")
    lifted = tmp_path / "lifted"
    lifted.mkdir()
    rate = {"value": 0.25, "low": 0.0, "high": 0.5}
    (lifted / "lifted.json").write_text(
        json.dumps({"lines": [{"scene": "table", "method": "steered_noise", "lifted": rate}]})
    )
    (lifted / "lifted.md").write_text("# Lifted\n")
    publish((evaluated,), executed=runs, lifted=(lifted,), root=root).run()
    assert " | 62.5 (50–75) | 25.0 (0–50) | 73.2 |" in (root / "README.md").read_text()
    results = (root / "docs" / "results.md").read_text()
    assert results.endswith(
        "# Executed 0.625\n\n![calibration](images/physics-calibration.svg)\n\n"
        "# Executed 0.125\n\n![calibration](images/elsewhere-calibration.svg)\n\n# Lifted\n"
    )
    assert (root / "docs" / "images" / "physics-calibration.svg").read_text() == "<svg>0.625</svg>"


def test_links_to_headings_are_those_that_github_makes(publish_module):
    texts = ["# Executed: test42.txt\n\nbody", "# With, and without\n", "# Executed: test42.txt\n"]
    assert publish_module.contents(texts) == (
        "- [Executed: test42.txt](#executed-test42txt)\n- [With, and without](#with-and-without)\n"
        "- [Executed: test42.txt](#executed-test42txt-1)\n"
    )


def test_what_is_left_out_stands_beside_the_whole(publish_module, tmp_path):
    def run(name, losses, method, value, **changed):
        folder = tmp_path / name
        folder.mkdir()
        rate = {"value": value, "low": 0.5, "high": 0.75}
        config = {"objects": "a/some.txt", "max_objects": 4, "num": 8, "seed": 1, "losses": losses} | changed
        line = {"scene": "shelf", "method": method, "objects": 4, "unverified": 1, "top": rate}
        report = {"config": config, "versions": {"dexnudge": "1.2.3"}, "lines": [line]}
        (folder / "executed.json").write_text(json.dumps(report))
        (folder / "report.json").write_text(json.dumps({"lines": [{**line, "single": {**rate, "value": value / 2}}]}))
        return folder

    whole, without = run("whole", None, "steered_noise", 0.75), run("without", {"sweep": 0.0}, "steered_noise", 0.5)
    raw = run("raw", None, "guidance_only", 0.25)
    text = publish_module.effects_table((whole, without, raw))
    assert "some.txt, 8 draws for each object and scene, seed 1, dexnudge 1.2.3." in text
    assert text.splitlines()[-3:] == [
        "| dexnudge | shelf | 4 | 37.5 (50–75) | 1 | 75.0 (50–75) |",
        "| dexnudge, weight sweep 0 | shelf | 4 | 25.0 (50–75) | 1 | 50.0 (50–75) |",
        "| dexnudge, not projected | shelf | 4 | 12.5 (50–75) | 1 | 25.0 (50–75) |",
    ]
    with pytest.raises(SystemExit, match="differ in objects"):
        publish_module.effects_table((whole, run("other", None, "steered_noise", 0.5, num=16)))
