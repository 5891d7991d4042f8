"""Hostile inputs of every reader: exit 2 and one message, or read; in bounded time and memory, and nothing else changed."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


@pytest.mark.slow
def test_each_input_is_read_or_refused(tmp_path):
    command = [sys.executable, "-m", "hostile.campaign", "--count", "500", "--seed", "0", "--out", str(tmp_path)]
    paths = os.pathsep.join(filter(None, (str(TESTS), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr[-2000:]
    rows = list(csv.DictReader((tmp_path / "outcomes.csv").read_text().splitlines()))
    wrong = [f"{row['reader']}: {row['name']}: {row['verdict']}" for row in rows]
    assert [line for line in wrong if not line.endswith((": refused", ": accepted"))] == []
    assert len(rows) == 500
    assert {row["verdict"] for row in rows} == {"refused", "accepted"}
