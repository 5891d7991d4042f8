"""A small training, killed in its middle, interrupted, and on a full disk, by the benchmark that does it to every job."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "kills.py"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the benchmark forks its jobs")
def test_a_training_that_is_killed_loses_and_doubles_nothing():
    options = ["--only", "train", "--kills", "4", "--interrupts", "1", "--sizes", "4096"]
    done = subprocess.run([sys.executable, BENCHMARK, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    row = next(line for line in done.stdout.splitlines() if line.startswith("train | ")).split(" | ")
    _, _, kills, _, lost, doubled, same, _, full_disk = row
    assert int(kills) == 4
    assert (lost, doubled, same, full_disk) == ("0", "0", "equal", "2")
