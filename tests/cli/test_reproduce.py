"""`dexnudge reproduce`: bad input, and a small real run that is killed and goes on."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dexnudge.objects.builtin import builtin_object

FOLDERS = ("with_base", "without_base")


def rows(out: Path) -> list[bytes]:
    files = [out / folder / "results.jsonl" for folder in FOLDERS]
    return [line for file in files if file.exists() for line in file.read_bytes().splitlines(keepends=True)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--num", 0], "--num is 0; expected at least 1"),
        (["--max-objects", 0], "--max-objects is 0; expected at least 1"),
        (["--workers", 0], "--workers is 0; expected at least 1"),
        (["--objects", "nowhere"], "nowhere: no such set of objects; expected builtin:train"),
        (["--scenes", "tabel"], "unknown scene 'tabel'; expected some of table, layers"),
        (["--parts", "harder"], "unknown part 'harder'; expected some of with_base, without_base"),
        (
            ["--methods", "mine"],
            "no part of this run has the method 'mine'; expected some of steered_noise, random_start_projection",
        ),
        (["--prediction-weights", "epsilon"], "got 'epsilon'; expected NAME=DIR with a name of letters"),
        (["--prediction-weights", "a/b=c"], "got 'a/b=c'; expected NAME=DIR with a name of letters"),
        (["--prediction-weights", "a=b", "a=c"], "--prediction-weights names 'a' twice; expected each name once"),
    ],
)
def test_bad_options(dexnudge, tmp_path, options, message):
    outcome = dexnudge("reproduce", "--quick", *options, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert message in outcome.err
    assert not (tmp_path / "out").exists()


def test_training_poses_that_are_not_there(dexnudge, tmp_path):
    options = ["--quick", "--max-objects", 1, "--num", 1, "--workers", 1, "--data", tmp_path / "nowhere"]
    outcome = dexnudge("reproduce", *options, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert "manifest.json: no such file; expected a dataset folder" in outcome.err


@pytest.mark.slow  # a dozen real rows, with the shipped weights
def test_a_killed_run_goes_on_and_reports(tmp_path):
    (tmp_path / "objects").mkdir()
    builtin_object("phone").export(tmp_path / "objects" / "phone.obj")
    out = tmp_path / "out"
    options = ["--objects", tmp_path / "objects", "--scenes", "table", "--num", "2", "--workers", "1", "--quick"]
    command = [sys.executable, "-m", "dexnudge", "reproduce", *map(str, options), "--out", str(out)]

    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(rows(out)) < 3:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = [line for line in rows(out) if line.endswith(b"\n")]
    assert 3 <= len(before) < 12

    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    after = rows(out)
    assert after[: len(before)] == before
    found = [json.loads(line) for line in after]
    methods = [(row["method"], index >= 8) for index, row in enumerate(found)]
    assert len(methods) == len(set(methods)) == 12
    assert all(row["status"] == "done" and len(row["success"]) == row["num"] == 2 for row in found)
    assert all(len(flags) == 2 for row in found for flags in row["swept"].values())
    assert [len(row["swept"]) for row in found] == [6] * 8 + [0] * 4
    report = (out / "report.md").read_text()
    assert done.stdout.startswith(report)
    assert "| table | steered_noise | 1 | 0 | 2 |" in (out / "with_base" / "report.md").read_text()
    assert "nearest_pose: needs a dataset, --data DIR" in report
    pictures = set(re.findall(r"\]\((pictures/failure[^)]+)\)", report))
    assert {f"pictures/{path.name}" for path in (out / "pictures").glob("failure-*.png")} == pictures
    assert pictures or "No draw was rejected." in report
