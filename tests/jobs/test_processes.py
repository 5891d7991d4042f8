"""Tasks in several processes: every task has one result, whatever dies."""

import os
import platform
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from dexnudge.errors import InputError, MeshError
from dexnudge.jobs import processes
from dexnudge.jobs.engines import run_tasks_by
from dexnudge.jobs.processes import WorkerDied, run_tasks

MOST_SECONDS = 600.0  # for processes to end; a bound for a failure, no measure of a quiet machine


def make_square():
    return lambda x: x * x


def make_fragile():
    def handle(x):
        if x == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return x

    return handle


def make_refusing():
    def handle(x):
        raise MeshError("no good") if x else ZeroDivisionError("steered_noise")

    return handle


def make_impossible():
    raise MeshError("nothing to load")


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_every_task_has_one_result(workers, count):
    results = dict(run_tasks(make_square, range(count), workers=workers))
    assert results == {x: x * x for x in range(count)}


def test_an_address_without_ray_is_refused():
    with pytest.raises(InputError, match="`ray_address` is given without `engine` ray"):
        run_tasks_by("processes", make_square, [1], workers=1, ray_address="here:1")


def test_a_killed_process_costs_its_own_task_only():
    results = dict(run_tasks(make_fragile, range(8), workers=2))
    assert results.pop(3) == WorkerDied(-signal.SIGKILL)
    assert results == {x: x for x in range(8) if x != 3}


def test_a_worker_takes_what_it_has_prepared_then_what_no_other_has_then_anything():
    groups = ["c", "b", "b", "a", "a"]  # of the waiting tasks, the next one last
    assert processes._next_place(groups, [], []) == 4
    assert processes._next_place(groups, ["b"], ["a"]) == 2
    assert processes._next_place(groups, ["d"], ["a"]) == 2
    assert processes._next_place(groups, [], ["a", "b"]) == 0
    assert processes._next_place(groups, ["d"], ["a", "b", "c"]) == 4


def test_tasks_that_belong_together_have_one_result_too():
    results = dict(run_tasks(make_square, range(20), workers=2, together=lambda task: task % 3))
    assert results == {x: x * x for x in range(20)}


@pytest.mark.parametrize("workers", [1, 2])
def test_deliberate_errors_arrive_as_they_are(workers):
    with pytest.raises(MeshError, match="no good"):
        list(run_tasks(make_refusing, [1, 1, 1], workers=workers))
    with pytest.raises(MeshError, match="nothing to load"):
        list(run_tasks(make_impossible, [1, 1], workers=workers))


def test_a_bug_in_a_process_arrives_with_its_traceback():
    with pytest.raises(RuntimeError, match=r"(?s)in a worker process, on 0:.*ZeroDivisionError: steered_noise"):
        list(run_tasks(make_refusing, [0], workers=2))


def make_patient(folder):
    """Leaves its process id in the folder and takes longer than any test."""

    def handle(x):
        (folder / str(os.getpid())).touch()
        time.sleep(24 * 3600)

    return handle


def test_a_single_worker_may_have_a_process_that_may_die():
    results = dict(run_tasks(make_fragile, [2, 3, 4], workers=1, isolated=True))
    assert results == {2: 2, 3: WorkerDied(-signal.SIGKILL), 4: 4}
    assert "died (exit code -9), for example for want of memory" in results[3].reason


PARENT = """
    import sys, time
    from functools import partial
    from pathlib import Path
    from dexnudge.jobs.processes import run_tasks

    sys.path.insert(0, {here!r})
    from test_processes import make_patient

    if __name__ == "__main__":
        list(run_tasks(partial(make_patient, Path(sys.argv[1])), [1, 2], workers=2))
"""


def is_alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_processes_end_with_the_one_that_started_them(tmp_path, how):
    script, folder = tmp_path / "parent.py", tmp_path / "running"
    script.write_text(textwrap.dedent(PARENT.format(here=str(Path(__file__).parent))))
    folder.mkdir()
    parent = subprocess.Popen(
        [sys.executable, script, folder], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    while len(children := [int(path.name) for path in folder.iterdir()]) < 2:
        assert parent.poll() is None
        time.sleep(0.02)
    if how == signal.SIGINT:
        os.killpg(parent.pid, how)  # as a terminal does on Ctrl-C: to the parent and its processes alike
    else:
        parent.kill()
    _, message = parent.communicate()
    deadline = time.monotonic() + MOST_SECONDS
    while any(map(is_alive, children)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not any(map(is_alive, children))
    assert message.count("Traceback") == (1 if how == signal.SIGINT else 0)  # the parent's own KeyboardInterrupt


def make_counting():
    """Answers with what a worker's libraries would take for their number of threads."""
    return lambda _: [os.environ[name] for name in processes.THREAD_VARIABLES]


def test_workers_have_one_thread_each_and_this_process_keeps_its_own(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    for _, threads in run_tasks(make_counting, [1, 2], workers=2):
        assert threads == ["1", "1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, 8),
        ({"cpu.max": "max 100000\n"}, 8),
        ({"cpu.max": "150000 100000\n"}, 2),
        ({"cpu.max": "1000 100000\n"}, 1),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 8),
        ({"cpu/cpu.cfs_quota_us": "300000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
    ],
)
def test_a_container_may_lend_fewer_cores_than_the_machine_has(monkeypatch, tmp_path, files, cores):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(processes, "CGROUPS", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert processes.available_cores() == cores


@pytest.mark.parametrize(
    ("said", "threads"), [("7", "7"), ("7,2", "7"), (None, str(processes.available_cores())), ("many", None)]
)
def test_the_users_number_of_threads_stands_for_all_libraries(monkeypatch, said, threads):
    for name in (*processes.THREAD_VARIABLES, "GOMP_SPINCOUNT"):
        monkeypatch.setenv(name, said or "x")
        if name != "OMP_NUM_THREADS" or said is None:
            monkeypatch.delenv(name)
    processes.limit_threads()
    assert os.environ["OMP_NUM_THREADS"] == (said or threads)
    assert os.environ["MKL_NUM_THREADS"] == (threads or str(processes.available_cores()))


def test_who_says_one_thread_gets_one_of_torch_and_of_warp():
    code = "import dexnudge, torch; from dexnudge.geometry import warp_runtime; "
    code += "print(torch.get_num_threads(), warp_runtime.THREADS)"
    names = (*processes.THREAD_VARIABLES, "GOMP_SPINCOUNT")
    environment = {name: value for name, value in os.environ.items() if name not in names} | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.split() == ["1", "1"]


@pytest.mark.parametrize("policy", [None, "active"])
def test_idle_threads_soon_sleep_unless_the_user_has_said_how_they_wait(monkeypatch, policy):
    for name in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY"):
        monkeypatch.setenv(name, policy or "x")
        monkeypatch.delenv(name)
    if policy:
        monkeypatch.setenv("OMP_WAIT_POLICY", policy)
    processes.limit_threads()
    assert os.environ.get("GOMP_SPINCOUNT") == (None if policy else processes.SPIN_COUNT)


@pytest.mark.skipif("glibc" not in platform.libc_ver(), reason="what other C libraries keep is theirs")
def test_memory_that_was_freed_between_what_is_held_goes_back_to_the_system():
    program = """
        import os
        from dexnudge.jobs.processes import release_memory

        def resident():
            with open("/proc/self/statm") as file:
                return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

        before, held = resident(), [bytes(6000) for _ in range(50_000)]
        held = held[::100]
        freed = resident()
        release_memory()
        print(freed - before, resident() - before)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    freed, released = map(float, done.stdout.split())
    assert freed > 250
    assert released < 50


def test_the_collector_leaves_libraries_alone_and_not_what_was_made_before_them():
    program = """
        import gc
        from dexnudge.jobs.processes import loading_libraries

        with loading_libraries():
            import trimesh
        print(gc.isenabled(), gc.get_freeze_count() > 50_000)
        gc.unfreeze()
        import torch
        with loading_libraries():
            import yaml
        print(gc.isenabled(), gc.get_freeze_count())
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True", "True", "0"]
