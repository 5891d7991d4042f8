"""Tasks on a local Ray cluster: every task answered once, and again where a worker was killed."""

import os
import signal
import socket
import sys
import threading
from functools import partial

import pytest

from dexnudge.errors import InputError, MeshError
from dexnudge.jobs.engines import run_tasks_on_ray
from dexnudge.jobs.processes import WorkerDied

ray = pytest.importorskip("ray")
pytestmark = [
    pytest.mark.slow,
    # Ray leaves sockets and files of its own processes to the garbage collector.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def make_fragile(folder):
    """Dies at its first try of task 3 and at every try of task 5; refuses task 9."""

    def handle(x):
        first = not (folder / str(x)).exists()
        (folder / str(x)).touch()
        if x == 5 or (x == 3 and first):
            os.kill(os.getpid(), signal.SIGKILL)
        if x == 9:
            raise MeshError("no good")
        return x * x

    return handle


def test_a_killed_worker_costs_time_and_no_task(tmp_path):
    results = dict(run_tasks_on_ray(partial(make_fragile, tmp_path), range(8), workers=2))
    assert results.pop(5) == WorkerDied(None)
    assert results == {x: x * x for x in range(8) if x != 5}


def test_deliberate_errors_arrive_as_they_are(tmp_path):
    with pytest.raises(MeshError, match="no good"):
        list(run_tasks_on_ray(partial(make_fragile, tmp_path), [9], workers=1))
    assert not ray.is_initialized()


def test_without_the_package_the_message_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(
        InputError, match=r"needs the package ray, .*; install it with `pip install 'dexnudge\[cluster\]'`"
    ):
        next(run_tasks_on_ray(partial(make_fragile, tmp_path), [1], workers=1))


def test_no_cluster_at_the_address(tmp_path):
    with pytest.raises(InputError, match=r"no Ray cluster answers at '127.0.0.1:1' .*ray start --head"):
        next(run_tasks_on_ray(partial(make_fragile, tmp_path), [1], workers=1, address="127.0.0.1:1"))


@pytest.mark.parametrize("address", ["127.0.0.1:{port}", "ray://127.0.0.1:{port}"])
@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_what_listens_at_the_address_is_not_ray(tmp_path, monkeypatch, address, answer):
    """Ray itself would wait for minutes."""
    monkeypatch.setattr("dexnudge.jobs.engines.REACHABLE", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        kept = []

        def serve():
            kept.append(server.accept()[0])  # which else would be closed
            kept[0].sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        address = address.format(port=server.getsockname()[1])
        with pytest.raises(
            InputError, match=r"no Ray cluster answers at .* \((timed out|what listens there is not Ray)"
        ):
            next(run_tasks_on_ray(partial(make_fragile, tmp_path), [1], workers=1, address=address))


@pytest.mark.parametrize("port", ["99999", "ten", ""])
def test_a_port_that_is_none(tmp_path, port):
    with pytest.raises(InputError, match=f"no Ray cluster answers at 'localhost:{port}'"):
        next(run_tasks_on_ray(partial(make_fragile, tmp_path), [1], workers=1, address=f"localhost:{port}"))
