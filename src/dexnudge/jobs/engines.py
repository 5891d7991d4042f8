"""The engines that run tasks: processes of this machine, or a Ray cluster (https://docs.ray.io)."""

import os
import socket
import uuid
from collections.abc import Callable, Generator, Hashable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

from dexnudge.errors import InputError
from dexnudge.jobs.processes import Raised, WorkerDied, run_tasks, use_one_thread, worker_result

Engine = Literal["processes", "ray"]
Task = TypeVar("Task")
Result = TypeVar("Result")


def run_tasks_by(
    engine: Engine,
    make_handler: Callable[[], Callable[[Task], Result]],
    tasks: Sequence[Task],
    *,
    workers: int,
    ray_address: str | None = None,
    isolated: bool = False,
    together: Callable[[Task], Hashable] | None = None,
) -> Generator[tuple[Task, Result | WorkerDied], None, None]:
    """Yield (task, result) in the order in which tasks finish, as `processes.run_tasks` does, with whose arguments.

    engine: `ray` asks every task of a cluster's own worker, so that `isolated` and `together` mean nothing to it.
    workers: cores of this machine. ray_address: of a running cluster, all of whose cores are used; None starts one here.

    Raises:
        InputError: a number of workers or an address that is not valid, one without `ray`, or Ray is not installed.
        Exception: whatever the handler raised, from the first task that did.
    """
    if engine != "ray" and ray_address is not None:
        raise InputError(
            "`ray_address` is given without `engine` ray; expected both; add `engine` ray, or leave it out"
        )
    if engine == "ray":
        return run_tasks_on_ray(make_handler, tasks, workers=workers, address=ray_address)
    return run_tasks(make_handler, tasks, workers=workers, isolated=isolated, together=together)


RETRIES = 3  # of a task whose worker died: machines of a cluster come and go, but a task may also be what kills them
REACHABLE = 8.0  # [s] for the head to answer; Ray itself tries for minutes
CLIENT = "ray://"  # before the address of a Ray client's server
# Ray speaks gRPC, which is HTTP/2: whoever serves it answers the opening of a connection with its settings.
OPENING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
FRAME_TYPE, SETTINGS = 3, 4  # where a frame's type stands, and that of settings
TASKS_PER_CORE = 2  # handed out ahead, so that no core waits for the next one

_HANDLERS: dict[str, Callable[[Any], Any]] = {}  # in a worker: what each run has loaded there


def run_tasks_on_ray(
    make_handler: Callable[[], Callable[[Task], Result]],
    tasks: Sequence[Task],
    *,
    workers: int,
    address: str | None = None,
) -> Generator[tuple[Task, Result | WorkerDied], None, None]:
    """Yield (task, result) in the order in which tasks finish, as `processes.run_tasks` does.

    Args:
        make_handler: picklable; called once in each worker, in the folder that is the current one here, where it is shared.
            dexnudge must be installed on every machine.
        tasks: picklable.
        workers: cores of the cluster that is started on this machine when there is no address.
        address: of a running cluster, "host:6379" or "auto"; all of its cores are used.

    Raises:
        InputError: Ray is not installed, or no cluster answers at the address.
        Exception: whatever the handler raised, from the first task that did.
    """
    ray = _connect(workers, address)
    try:
        # One function object for all tasks: Ray sends it to each worker once.
        remote = ray.remote(_work).options(num_cpus=1, max_retries=RETRIES)
        run, handler, folder = uuid.uuid4().hex, ray.put(make_handler), str(Path.cwd())
        ahead = TASKS_PER_CORE * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting = list(reversed(tasks))
        running: dict[Any, Task] = {}
        while waiting or running:
            while waiting and len(running) < ahead:
                task = waiting.pop()
                running[remote.remote(run, folder, handler, task)] = task
            finished, _ = ray.wait(list(running))
            for reference in finished:
                task = running.pop(reference)
                result: Any
                try:
                    result = ray.get(reference)
                except ray.exceptions.RayError:  # `_work` raises nothing: this is the death of its last worker
                    result = WorkerDied(None)
                if isinstance(result, Raised):
                    raise result.error
                yield task, result
    finally:
        ray.shutdown()  # ends what still runs


def _connect(workers: int, address: str | None) -> Any:
    try:
        import ray
    except ImportError as error:
        raise InputError(
            "the engine 'ray' needs the package ray, which is not installed; "
            "install it with `pip install 'dexnudge[cluster]'`, or use the engine 'processes'"
        ) from error
    if address == "":
        raise InputError("the address of the Ray cluster is empty; expected host:port of its head; or leave it out")
    here = {"address": "local", "num_cpus": workers, "include_dashboard": False}  # whatever RAY_ADDRESS says
    options: dict[str, Any] = {"address": address} if address else here
    try:
        if address and ":" in address:
            _check_answers(address.removeprefix(CLIENT))
        ray.init(**options, log_to_driver=False, logging_level="error")
    except (OSError, OverflowError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise InputError(
            f"no Ray cluster answers at {address!r} ({error}); expected host:port of its head, or auto on a machine "
            "that belongs to it; start one with `ray start --head`, or leave the address out"
        ) from error
    return ray


def _check_answers(address: str) -> None:
    """Raise OSError or ValueError where nothing at host:port answers as Ray does, within `REACHABLE`."""
    host, _, port = address.rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), timeout=REACHABLE) as connection:
        connection.sendall(OPENING)
        answer = connection.recv(FRAME_TYPE + 1, socket.MSG_WAITALL)
    if len(answer) <= FRAME_TYPE or answer[FRAME_TYPE] != SETTINGS:
        raise ConnectionError("what listens there is not Ray")


def _work(run: str, folder: str, make_handler: Callable[[], Callable[[Any], Any]], task: Any) -> Any:
    """Return the result of a task, in a worker that loads the handler of a run once, in the folder of the run."""
    use_one_thread()

    def get_handler() -> Callable[[Any], Any]:
        if run not in _HANDLERS:
            if Path(folder).is_dir():
                os.chdir(folder)
            _HANDLERS[run] = make_handler()
        return _HANDLERS[run]

    return worker_result(get_handler, task)
