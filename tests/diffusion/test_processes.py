"""Processes that share a batch take the steps that one process takes."""

import json
import subprocess
import sys

import pytest
import torch
from safetensors.torch import load_file

from dexnudge.diffusion.checkpoint import STATE_NAME
from dexnudge.diffusion.distributed import Processes
from dexnudge.errors import InputError

TINY = ["--width", "32", "--depth", "2", "--num-heads", "2", "--groups", "4", "--rows-per-group", "4"]
STEPS = ["--steps", "12", "--validate-every", "6", "--checkpoint-every", "6", "--num-threads", "1"]
FLOAT32_DRIFT = 1e-6  # of weights below 1 after 12 steps: sums over a batch are rounded in another order


def test_shares_cover_the_batch_once():
    shares = [Processes(rank=rank, count=3).share(12) for rank in range(3)]
    assert [k for share in shares for k in range(share.start, share.stop)] == list(range(12))
    with pytest.raises(InputError, match=r"a batch has 8 groups for 3 processes; expected a multiple; change `groups`"):
        Processes(count=3).share(8)


def test_one_process_averages_nothing():
    tensor = torch.arange(3.0)
    Processes().average([tensor])
    assert tensor.tolist() == [0.0, 1.0, 2.0]
    assert Processes().largest(0.25) == 0.25


@pytest.mark.slow
def test_two_processes_end_in_the_weights_of_one(toy, tmp_path):
    toy.write_toy_dataset(tmp_path / "data")
    train = ["-m", "dexnudge", "train", "--data", str(tmp_path / "data"), *TINY, *STEPS]
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    for name, launcher in (("one", []), ("two", torchrun)):
        command = [sys.executable, *launcher, *train, "--out", str(tmp_path / name)]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("12 steps in") == 1  # one of the processes reports
    one, two = (load_file(tmp_path / name / STATE_NAME) for name in ("one", "two"))
    assert one.keys() == two.keys()
    moved = 0.0
    for name, tensor in one.items():
        if name.startswith(("weights/", "average/")):
            torch.testing.assert_close(two[name], tensor, atol=FLOAT32_DRIFT, rtol=0.0)
            moved = max(moved, float(tensor.abs().max()))
    assert moved > 0.01
    texts = [(tmp_path / name / "train.jsonl").read_text() for name in ("one", "two")]
    logs = [[json.loads(line) for line in text.splitlines()] for text in texts]
    found = [[line["validation/loss"] for line in log if "validation/loss" in line] for log in logs]
    assert found[0] == pytest.approx(found[1], rel=1e-3)
    done = subprocess.run(
        [sys.executable, *train, "--out", str(tmp_path / "two")],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 2
    assert "cannot be continued: processes was 2, is now 1" in done.stderr
