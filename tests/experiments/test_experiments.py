"""Experiments go on after any interruption, without a row lost or doubled."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError, MeshError, OutputError
from dexnudge.experiments import experiments
from dexnudge.experiments.config import ExperimentConfig, Task, all_tasks, row_seed
from dexnudge.experiments.experiments import run_experiment
from dexnudge.experiments.row_maker import RowMaker
from dexnudge.experiments.rows import FILE, Row, read_rows
from dexnudge.hands.shadow_lite import shadow_lite
from dexnudge.jobs.processes import WorkerDied
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.sampler import Sampler

SLOW_EXPERIMENT = Path(__file__).with_name("slow_experiment.py")
CONFIG = ExperimentConfig(objects="builtin:test", scenes=("table",), num=4)


class InstantRowMaker:
    """Rows without sampling."""

    made: list[str] = []  # noqa: RUF012  shared on purpose: the test looks at it

    def __init__(self, config):
        self.config = config

    def __call__(self, task):
        self.made.append(task.object)
        return Row(
            object=task.object,
            scene=task.scene,
            method=task.method,
            status="sampled",
            num=4,
            seed=0,
            success=[True] * 4,
        )


@pytest.fixture(autouse=True)
def instant(monkeypatch):
    InstantRowMaker.made = []
    monkeypatch.setattr(experiments, "RowMaker", InstantRowMaker)


def test_a_second_run_computes_only_what_is_missing(tmp_path):
    rows = run_experiment(CONFIG, tmp_path / "out", workers=1)
    assert len(rows) == len(set(InstantRowMaker.made)) == 42
    lines = (tmp_path / "out" / FILE).read_bytes().splitlines(keepends=True)
    (tmp_path / "out" / FILE).write_bytes(b"".join(lines[:40]) + lines[40][:25])
    InstantRowMaker.made.clear()
    assert run_experiment(CONFIG, tmp_path / "out", workers=1) == rows
    assert len(InstantRowMaker.made) == 2
    assert {row.key for row in read_rows(tmp_path / "out")} == {row.key for row in rows}


def test_progress_counts_finished_rows(tmp_path):
    seen = []
    run_experiment(CONFIG, tmp_path / "out", workers=1, on_row=lambda row, done, total: seen.append((done, total)))
    assert seen == [(done, 42) for done in range(1, 43)]


def test_other_options_are_refused_by_name(tmp_path):
    run_experiment(CONFIG, tmp_path / "out", workers=1)
    with pytest.raises(InputError, match=r"holds another experiment: num is 4 there and 5 here"):
        run_experiment(replace(CONFIG, num=5), tmp_path / "out", workers=1)
    with pytest.raises(InputError, match=r"losses is None there and \{'sweep': 0.0\} here"):
        run_experiment(replace(CONFIG, losses={"sweep": 0.0}), tmp_path / "out", workers=1)


def test_a_folder_of_something_else_is_refused_and_kept(tmp_path):
    (tmp_path / "thesis.tex").write_text("years")
    with pytest.raises(OutputError, match="holds no experiment"):
        run_experiment(CONFIG, tmp_path, workers=1)
    assert os.listdir(tmp_path) == ["thesis.tex"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": ()}, "no scene is named"),
        ({"scenes": ("table", "table")}, "the scene 'table' is named twice"),
        ({"scenes": ("tabel",)}, "unknown scene 'tabel'; expected some of table, layers, shelf"),
        ({"methods": ("our",)}, "unknown method 'our'; expected some of steered_noise"),
        ({"num": 0}, "--num is 0; expected at least 1"),
        ({"losses": {"sweep": -1.0}}, "the weight 'sweep' of the energy is -1; expected a finite number, 0 or more"),
        ({"max_objects": 0}, "--max-objects is 0; expected at least 1"),
    ],
)
def test_bad_options_are_refused_before_anything_is_written(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        run_experiment(replace(CONFIG, **changes), tmp_path / "out", workers=1)
    assert os.listdir(tmp_path) == []


def test_a_dead_worker_becomes_a_failed_row(tmp_path, monkeypatch):
    monkeypatch.setattr(experiments, "run_tasks", lambda _make, tasks, **_: ((task, WorkerDied(-9)) for task in tasks))
    rows = run_experiment(CONFIG, tmp_path / "out", workers=2)
    assert {row.status for row in rows} == {"failed"}
    assert {row.num for row in rows} == {4}
    assert rows[0].reason == "the worker process died with exit code -9"


def test_seeds_are_the_same_for_methods_and_differ_for_objects_scenes_and_experiments():
    task = Task("phone", "table", "steered_noise")
    assert row_seed(0, task) == row_seed(0, Task("phone", "table", "unguided"))
    others = [
        row_seed(0, Task("phone", "shelf", "steered_noise")),
        row_seed(0, Task("book", "table", "steered_noise")),
        row_seed(1, task),
    ]
    assert len({row_seed(0, task), *others}) == 4


def test_fewer_objects_are_spread_over_the_set_and_its_rows_stand_together():
    every = [task.object for task in all_tasks(CONFIG)]
    tasks = all_tasks(replace(CONFIG, max_objects=4, methods=("steered_noise", "unguided")))
    assert [task.object for task in tasks[::2]] == [every[0], every[10], every[21], every[31]]
    assert [task.method for task in tasks[:2]] == ["steered_noise", "unguided"]
    assert tasks[0].object == tasks[1].object
    assert len(all_tasks(replace(CONFIG, max_objects=100))) == 42


def test_what_a_run_left_that_was_killed_before_its_first_file_does_not_stop_the_next(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "experiment.partial").write_text('{"format')
    assert len(run_experiment(CONFIG, tmp_path / "out", workers=1)) == 42


@pytest.mark.slow  # six processes import torch
def test_a_run_killed_again_and_again_ends_with_every_row_once(tmp_path):
    command = [sys.executable, str(SLOW_EXPERIMENT), str(tmp_path / "out")]
    for finished in (5, 60):
        process = subprocess.Popen(command, stderr=subprocess.PIPE)
        _wait_until(lambda want=finished: _lines(tmp_path / "out") >= want)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stderr.close()
    workers = {int(row.seconds["process"]) for row in read_rows(tmp_path / "out")}
    _wait_until(lambda: not any(_alive(pid) for pid in workers))
    subprocess.run(command, check=True, timeout=60)
    rows = read_rows(tmp_path / "out")
    assert len({row.key for row in rows}) == len(rows) == 42 * 3


def _lines(folder: Path) -> int:
    file = folder / FILE
    return file.read_bytes().count(b"\n") if file.exists() else 0


def _wait_until(condition, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def _alive(pid: int) -> bool:
    """Whether the process still runs; one that has ended but that nobody has waited for does not."""
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


class TestRowMaker:
    """With real objects and scenes, and a sampler that is never reached."""

    @pytest.fixture
    def make(self, monkeypatch, tmp_path):
        from dexnudge.sampling.sampler import Sampler

        monkeypatch.undo()
        monkeypatch.setattr(Sampler, "load", lambda *_: None)
        (tmp_path / "objects").mkdir()
        (tmp_path / "objects" / "broken.obj").write_text("v 0 0 0\n")
        return lambda: RowMaker(replace(CONFIG, objects=str(tmp_path / "objects"), scenes=("shelf",)))

    def test_an_object_that_cannot_be_read_is_a_failed_row(self, make):
        row = make()(Task("broken", "shelf", "steered_noise"))
        assert (row.status, row.num, row.success) == ("failed", 4, [])
        assert row.reason.startswith(MeshError.__name__)

    def test_an_object_that_does_not_fit_is_a_failed_row(self, make, tmp_path):
        trimesh.creation.box((0.5, 0.5, 0.5)).export(tmp_path / "objects" / "cube.obj")
        row = make()(Task("cube", "shelf", "steered_noise"))
        assert row.status == "failed"
        assert row.reason.startswith("SceneError")


@pytest.mark.slow  # draws three times
def test_draws_are_made_with_the_losses_of_the_config(tmp_path):
    (tmp_path / "objects").mkdir()
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "objects" / "box.obj")
    methods, task = ("random_start_projection",), Task("box", "table", "random_start_projection")
    config = replace(CONFIG, objects=str(tmp_path / "objects"), methods=methods, num=2)
    losses = {"sweep": 0.0, "clearance_base": 0.05}
    changed = RowMaker(replace(config, losses=losses)).draw(task)
    direct = Sampler(shadow_lite()).sample(
        changed.scene,
        num=2,
        seed=row_seed(CONFIG.seed, task),
        method=find_method(methods[0]).with_weights(losses),
    )
    np.testing.assert_array_equal(changed.draws.q, direct.q)
    assert not np.array_equal(changed.draws.q, RowMaker(config).draw(task).draws.q)
