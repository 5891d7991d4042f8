"""Tasks in several processes: every task answered once, whatever dies."""

import os
import signal

import pytest

from dexnudge.errors import MeshError
from dexnudge.evaluation.workers import WorkerDied, run_tasks


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
        raise MeshError("no good") if x else ZeroDivisionError("ours")

    return handle


def make_impossible():
    raise MeshError("nothing to load")


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_every_task_is_answered_once(workers, count):
    results = dict(run_tasks(make_square, range(count), workers=workers))
    assert results == {x: x * x for x in range(count)}


def test_a_killed_process_costs_its_own_task_only():
    results = dict(run_tasks(make_fragile, range(8), workers=2))
    assert results.pop(3) == WorkerDied(-signal.SIGKILL)
    assert results == {x: x for x in range(8) if x != 3}


@pytest.mark.parametrize("workers", [1, 2])
def test_deliberate_errors_arrive_as_they_are(workers):
    with pytest.raises(MeshError, match="no good"):
        list(run_tasks(make_refusing, [1, 1, 1], workers=workers))
    with pytest.raises(MeshError, match="nothing to load"):
        list(run_tasks(make_impossible, [1, 1], workers=workers))


def test_a_bug_in_a_process_arrives_with_its_traceback():
    with pytest.raises(RuntimeError, match=r"(?s)in a worker process, on 0:.*ZeroDivisionError: ours"):
        list(run_tasks(make_refusing, [0], workers=2))
