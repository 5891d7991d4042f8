"""Executions of an experiment go on after any interruption, without a row lost or doubled; what fails is counted."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from dexnudge.errors import InputError, SceneError
from dexnudge.experiments import execution_experiment as experiment
from dexnudge.experiments import lift_experiment
from dexnudge.experiments.config import ExperimentConfig, Task, all_tasks
from dexnudge.experiments.execution_experiment import FOLDER, read_executions, run_executions
from dexnudge.experiments.experiment_maker import ExecutionRowMaker
from dexnudge.experiments.experiment_rows import ExecutionRow
from dexnudge.experiments.rows import FILE, Row, RowWriter

SLOW = Path(__file__).with_name("slow_executions.py")
CONFIG = ExperimentConfig(objects="builtin:test", scenes=("table",), num=4)


class InstantMaker:
    """Rows without physics."""

    made: list[str] = []  # noqa: RUF012  shared on purpose: the tests look at it
    executed = None  # the factory of the same name

    def __init__(self, _config, num, **_):
        self.num = num

    def __call__(self, task):
        self.made.append(task.object)
        done = [self.executed(rank, 3.0 - rank) for rank in range(self.num)]
        return ExecutionRow(
            object=task.object, scene=task.scene, method=task.method, status="executed", seed=0, configurations=done
        )


@pytest.fixture
def out(tmp_path, monkeypatch, executed):
    InstantMaker.made, InstantMaker.executed = [], staticmethod(executed)
    monkeypatch.setattr(experiment, "ExecutionRowMaker", InstantMaker)
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_a_second_run_computes_only_what_is_missing(out, executed):
    rows = run_executions(CONFIG, out, num=2, workers=1)
    assert len(rows) == len(set(InstantMaker.made)) == 42
    file = out / FOLDER / FILE
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:40]) + lines[40][:25])
    InstantMaker.made.clear()
    assert run_executions(CONFIG, out, num=2, workers=1) == rows
    assert len(InstantMaker.made) == 2
    kept = [json.loads(line)["object"] for line in file.read_bytes().splitlines()]
    assert sorted(kept) == sorted({row.object for row in rows})
    assert read_executions(out)[1][0].configurations[1] == executed(1, 2.0)


def test_other_options_are_refused_by_name(out):
    run_executions(CONFIG, out, num=2, workers=1)
    with pytest.raises(InputError, match="holds another experiment: execute_num is 2 there and 3 here"):
        run_executions(CONFIG, out, num=3, workers=1)
    with pytest.raises(InputError, match="holds another experiment: seed is 0 there and 1 here"):
        run_executions(replace(CONFIG, seed=1), out, num=2, workers=1)


def test_what_the_experiment_already_knows_to_fail_is_counted_and_not_drawn(out):
    own = [task.object for task in all_tasks(CONFIG)[:3]]
    common = {"scene": "table", "method": "steered_noise", "num": 4, "seed": 7}
    writer = RowWriter(out)
    writer.append(Row(object=own[0], status="failed", reason="MeshError: no", **common))
    writer.append(Row(object=own[1], status="sampled", success=[False] * 4, force_margin=[0.5] * 4, **common))
    writer.append(Row(object=own[2], status="sampled", success=[True] * 4, force_margin=[2.0] * 4, **common))
    writer.close()
    rows = {row.object: row for row in run_executions(CONFIG, out, workers=1)}
    assert (rows[own[0]].status, rows[own[0]].reason) == ("failed", "MeshError: no")
    assert (rows[own[1]].status, rows[own[1]].drawn, rows[own[1]].configurations) == ("executed", 4, [])
    assert rows[own[2]].top_succeeded
    assert len(rows) == 42
    assert not {own[0], own[1]} & set(InstantMaker.made)


def test_progress_counts_finished_rows(out):
    seen = []
    run_executions(CONFIG, out, workers=1, on_row=lambda row, done, total: seen.append((done, total)))
    assert seen == [(done, 42) for done in range(1, 43)]


def test_what_cannot_be_placed_is_a_failed_row(monkeypatch):
    class Refusing:
        def __init__(self, _config):
            pass

        def draw(self, _task):
            raise SceneError("it does not fit")

    monkeypatch.setattr("dexnudge.experiments.experiment_maker.RowMaker", Refusing)
    row = ExecutionRowMaker(CONFIG, 1, errors=False)(Task("phone", "shelf", "steered_noise"))
    assert (row.status, row.reason, row.top_succeeded) == ("failed", "SceneError: it does not fit", False)


@pytest.mark.slow  # six processes import torch
@pytest.mark.parametrize("kept", [experiment.KEPT, lift_experiment.KEPT], ids=lambda kept: kept.name)
def test_a_run_killed_in_the_middle_ends_with_every_row_once(tmp_path, kept):
    out = tmp_path / "out"
    command = [sys.executable, str(SLOW), str(out), kept.name]
    process = subprocess.Popen(command)
    deadline = time.monotonic() + 120.0
    while _lines(out / kept.name) < 20:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = {row.key for row in kept.read(out)[1]}
    subprocess.run(command, check=True, timeout=120)
    rows = kept.read(out)[1]
    assert len({row.key for row in rows}) == len(rows) == 84
    assert before < {row.key for row in rows}


@pytest.mark.slow  # processes import torch
@pytest.mark.parametrize("kept", [experiment.KEPT, lift_experiment.KEPT], ids=lambda kept: kept.name)
def test_a_task_that_kills_its_worker_is_counted_and_the_others_go_on(tmp_path, kept):
    victim = all_tasks(CONFIG)[5].object
    environment = {**os.environ, "KILLS_ITS_WORKER": victim}
    command = [sys.executable, str(SLOW), str(tmp_path / "out"), kept.name]
    subprocess.run(command, check=True, timeout=300, env=environment)
    rows = kept.read(tmp_path / "out")[1]
    assert len(rows) == 84
    assert {row.object for row in rows if row.status == "failed"} == {victim}
    assert [row.reason for row in rows if row.status == "failed"] == [
        "its worker process died (exit code 9), for example for want of memory"
    ] * 2


def _lines(folder: Path) -> int:
    file = folder / FILE
    return file.read_bytes().count(b"\n") if file.exists() else 0
