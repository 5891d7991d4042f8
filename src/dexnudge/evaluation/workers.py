"""Run many tasks in a few processes; a process that dies costs one task, not the run."""

import multiprocessing
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from dexnudge.errors import DexnudgeError

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class WorkerDied:
    """Stands for the result of a task whose process was killed, for example for want of memory."""

    exit_code: int | None


@dataclass(frozen=True)
class _Raised:
    error: Exception


@dataclass
class _Worker(Generic[Task]):
    process: BaseProcess
    connection: Connection
    task: Task


def run_tasks(
    make_handler: Callable[[], Callable[[Task], Result]], tasks: Sequence[Task], *, workers: int
) -> Iterator[tuple[Task, Result | WorkerDied]]:
    """Yield (task, result) in the order in which tasks finish.

    Args:
        make_handler: picklable; called once in each process, so that it can load what all tasks need.
        tasks: picklable.
        workers: number of processes, each with one torch thread; with 1 everything runs in this process.

    Raises:
        Exception: whatever the handler raised, from the first task that did.
    """
    if workers <= 1:
        handle = make_handler()
        for task in tasks:
            yield task, handle(task)
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy the state of torch's and Warp's threads
    waiting = list(reversed(tasks))
    busy: list[_Worker[Task]] = []
    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                busy.append(_start(context, make_handler, waiting.pop()))
            ready = wait([worker.connection for worker in busy])
            for worker in [worker for worker in busy if worker.connection in ready]:
                task = worker.task
                try:
                    result = worker.connection.recv()
                except EOFError:
                    worker.process.join()
                    busy.remove(worker)
                    result = WorkerDied(worker.process.exitcode)
                else:
                    if isinstance(result, _Raised):
                        raise result.error
                    if waiting:
                        worker.task = waiting.pop()
                        worker.connection.send(worker.task)
                    else:
                        _stop(worker)
                        busy.remove(worker)
                yield task, result
    finally:
        for worker in busy:
            worker.process.terminate()
            worker.process.join()


def _start(context: Any, make_handler: Callable[[], Callable[[Task], Result]], task: Task) -> _Worker[Task]:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, make_handler), daemon=True)
    process.start()
    theirs.close()  # so that the death of the process is an end of file here
    ours.send(task)
    return _Worker(process, ours, task)


def _stop(worker: _Worker[Any]) -> None:
    worker.connection.close()
    worker.process.join()


def _serve(connection: Connection, make_handler: Callable[[], Callable[[Any], Any]]) -> None:
    """Answer tasks until the other side closes the pipe or dies."""
    if "torch" in sys.modules:  # imported along with the handler, if it is needed at all
        sys.modules["torch"].set_num_threads(1)
    handle: Callable[[Any], Any] | None = None
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        answer: Any
        try:
            handle = handle or make_handler()
            answer = handle(task)
        except DexnudgeError as error:
            answer = _Raised(error)
        except Exception:  # noqa: BLE001  a bug: carried to the parent, which raises it
            answer = _Raised(RuntimeError(f"in a worker process, on {task!r}:\n{traceback.format_exc()}"))
        try:
            connection.send(answer)
        except BrokenPipeError:
            return
