"""Two commands on one output folder, as real processes: the second is refused, and a killed one owns nothing."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trimesh

from dexnudge.jobs.folders import new_folder

ENDLESS = ["--method", "random_start_projection", "--num", "4", "--verified", "10000"]
SHORT = ["--method", "random_start_projection", "--num", "1"]


def start(*arguments: object, until: Path) -> subprocess.Popen:
    """A running command, once it has made the file `until`."""
    command = [sys.executable, "-m", "dexnudge", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (until.exists() and until.stat().st_size):
        assert process.poll() is None
        time.sleep(0.02)
    return process


def test_of_two_samples_the_second_is_refused_and_goes_once_the_first_was_killed(dexnudge, tmp_path):
    sample = ["sample", "phone", "--scene", "table", "--out", tmp_path / "out"]
    first = start(*sample, *ENDLESS, until=tmp_path / ".out.dexnudge-lock")
    try:
        for option in ([], ["--overwrite"]):
            second = dexnudge(*sample, *SHORT, *option)
            assert second.code == 2
            assert second.err.startswith(
                f"dexnudge: the output folder {tmp_path / 'out'} is being written by process {first.pid} on "
            )
            assert re.search(
                r"\(dexnudge sample phone --scene table .*\); expected one run at a time; wait for it to end, or "
                r"choose another --out\n$",
                second.err,
            )
    finally:
        first.kill()
        first.wait()
    assert dexnudge(*sample, *SHORT).code in (0, 3)
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out" / "configurations.npz").is_file()


@pytest.mark.slow
def test_of_two_evaluations_the_second_is_refused_and_goes_on_once_the_first_was_killed(dexnudge, tmp_path):
    (tmp_path / "objects").mkdir()
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "objects" / "box.obj")
    evaluate = ["evaluate", "--objects", tmp_path / "objects", "--scenes", "table", "--out", tmp_path / "out"]
    evaluate += ["--method", "random_start_projection", "--num", 1, "--workers", 1]
    first = start(*evaluate, until=tmp_path / "out" / ".dexnudge-lock")
    first.send_signal(19)  # SIGSTOP: it can neither end nor go on
    try:
        second = dexnudge(*evaluate)
        assert second.code == 2
        assert f"is being written by process {first.pid} on " in second.err
    finally:
        first.kill()
        first.wait()
    assert dexnudge(*evaluate).code == 0
    assert len((tmp_path / "out" / "results.jsonl").read_text().splitlines()) == 1


@pytest.mark.parametrize(
    "command",
    [
        ["dataset", "generate", "--objects", "builtin:test"],
        ["evaluate", "--objects", "builtin:test"],
        ["reproduce"],
        ["sample", "phone", "--scene", "table"],
        ["hand", "shadow_lite"],
    ],
    ids=lambda command: command[0],
)
def test_every_command_that_writes_refuses_an_owned_folder(dexnudge, tmp_path, command):
    flag = "--prepare" if command[0] == "hand" else "--out"
    with new_folder(tmp_path / "out", marker="m"):
        outcome = dexnudge(*command, flag, tmp_path / "out")
    assert outcome.code == 2
    assert outcome.err.startswith(f"dexnudge: the output folder {tmp_path / 'out'} is being written by process")
    assert outcome.err.endswith(f"wait for it to end, or choose another {flag}\n")


@pytest.mark.parametrize("command", ["train", "plan", "execute"])
def test_what_goes_on_from_a_folder_refuses_an_owned_output(dexnudge, toy, sampled, tmp_path, command):
    toy.write_toy_dataset(tmp_path)
    given = ["--data", tmp_path] if command == "train" else [sampled]
    with new_folder(tmp_path / "out", marker="m"):
        outcome = dexnudge(command, *given, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert outcome.err.startswith(f"dexnudge: the output folder {tmp_path / 'out'} is being written by process")
    assert outcome.err.endswith("wait for it to end, or choose another --out\n")
