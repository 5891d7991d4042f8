"""Run many tasks in a few processes; a process that dies costs one task, not the run."""

import ctypes
import gc
import math
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Generic, TypeVar

from dexnudge.errors import DexnudgeError, check_integer

# What torch, NumPy's and SciPy's linear algebra and CoACD read when they are first imported.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# Turns that an idle thread of torch waits before it sleeps, some 30 us. GNU OpenMP's own 300,000 take longer than a
# layer of the network; where others need the cores too, that made a draw ten times slower.
SPIN_COUNT = "10000"
CGROUPS = Path("/sys/fs/cgroup")
MOST_WORKERS = 1024  # more than the cores of any machine; each is a process of some 500 MB


def available_cores() -> int:
    """Return how many cores this process may use: its affinity and, in a container, its share of processor time."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    return max(1, math.ceil(min(cores, _cpu_quota())))


def _cpu_quota() -> float:
    """Return the cores whose time the control groups (version 2, else 1) lend; infinite without a limit."""
    try:
        quota, period = (CGROUPS / "cpu.max").read_text(encoding="ascii").split()
    except OSError:
        try:
            quota, period = ((CGROUPS / f"cpu/cpu.cfs_{name}_us").read_text("ascii") for name in ("quota", "period"))
        except OSError:
            return math.inf
    return math.inf if quota == "max" or int(quota) <= 0 else int(quota) / int(period)


def thread_count() -> int:
    """Return how many threads a computation takes: what the user says by OMP_NUM_THREADS, else `available_cores`."""
    said = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]  # with commas: of loops in loops
    return max(1, int(said)) if said.isdecimal() else available_cores()


def limit_threads() -> None:
    """Let libraries that are imported from now on use no more threads than `thread_count`, unless the user has said."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, str(thread_count()))
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", SPIN_COUNT)


@contextmanager
def loading_libraries() -> Iterator[None]:
    """Keep Python's collector off what is imported in here, now and later: it would look through all of it again and again.

    Nothing happens where torch is loaded already: what else has been made by then is not there for good.
    """
    if "torch" in sys.modules or not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def release_memory() -> None:
    """Give back what nothing holds any longer: meshes, which hold themselves in cycles, and what the C library keeps of it.

    Python's collector counts objects and not bytes, so it hardly ever begins.
    """
    gc.collect()
    trim_memory()


def trim_memory() -> None:
    """Give back what was freed: glibc keeps it, in pieces that what comes next does not fit into."""
    if sys.platform == "linux" and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)):
        trim(0)


@dataclass(frozen=True)
class WorkerDied:
    """Stands for the result of a task whose process was killed, for example for want of memory."""

    exit_code: int | None

    @property
    def reason(self) -> str:
        """The same in words."""
        how = "" if self.exit_code is None else f" (exit code {self.exit_code})"
        return f"its worker process died{how}, for example for want of memory"


@dataclass(frozen=True)
class Raised:
    """An error on its way to the process that gave the task, which raises it."""

    error: Exception


def worker_result(get_handler: Callable[[], Callable[[Any], Any]], task: Any) -> Any:
    """Return the handler's result, or `Raised`: a deliberate error as it is, any other with its traceback."""
    try:
        return get_handler()(task)
    except DexnudgeError as error:
        return Raised(error)
    except Exception:  # noqa: BLE001  a bug: carried to the other side, which raises it
        return Raised(RuntimeError(f"in a worker process, on {task!r}:\n{traceback.format_exc()}"))


def use_one_thread() -> None:
    """Let torch use one thread, since there are as many processes as cores; call it once torch is imported."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass
class _Worker(Generic[Task]):
    process: BaseProcess
    connection: Connection
    task: Task


def run_tasks(
    make_handler: Callable[[], Callable[[Task], Result]],
    tasks: Sequence[Task],
    *,
    workers: int,
    isolated: bool = False,
    together: Callable[[Task], Hashable] | None = None,
) -> Generator[tuple[Task, Result | WorkerDied], None, None]:
    """Yield (task, result) in the order in which tasks finish.

    The processes leave Ctrl-C to this one, and end when it ends, however it ends.

    Args:
        make_handler: picklable; called once in each process, so that it can load what all tasks need.
        tasks: picklable.
        workers: number of processes, 1 to 1024, each with one thread.
        isolated: a single worker gets a process of its own, too, which may die; else it works in this process.
        together: tasks of equal value share what is prepared for them: a worker prefers those of its last task, then
            those of no other worker.

    Raises:
        InputError: another number of workers.
        Exception: whatever the handler raised, from the first task that did.
    """
    check_integer("workers", workers, least=1, most=MOST_WORKERS)
    if workers <= 1 and not isolated:
        handle = make_handler()
        for task in tasks:
            yield task, handle(task)
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy the state of torch's and Warp's threads
    waiting = list(reversed(tasks))
    busy: list[_Worker[Task]] = []

    def place_for(worker: _Worker[Task] | None) -> int:
        if together is None:
            return len(waiting) - 1
        others = [together(other.task) for other in busy if other is not worker]
        return _next_place([together(task) for task in waiting], [together(worker.task)] if worker else [], others)

    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                busy.append(_start(context, make_handler, waiting.pop(place_for(None))))
            ready = wait([worker.connection for worker in busy])
            for worker in [worker for worker in busy if worker.connection in ready]:
                task, result = worker.task, _receive(worker)
                if isinstance(result, Raised):
                    raise result.error
                if isinstance(result, WorkerDied) or not _give_next(worker, waiting, place_for(worker)):
                    worker.connection.close()
                    worker.process.join()
                    busy.remove(worker)
                yield task, result
    finally:
        for worker in busy:
            worker.process.terminate()
            worker.process.join()


def _start(context: Any, make_handler: Callable[[], Callable[[Task], Result]], task: Task) -> _Worker[Task]:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, make_handler), daemon=True)
    with _interrupts_blocked(), _one_thread_inherited():
        process.start()
    theirs.close()  # so that the death of the process is an end of file here
    ours.send(task)
    return _Worker(process, ours, task)


@contextmanager
def _one_thread_inherited() -> Iterator[None]:
    """Processes started in here load their libraries with one thread each."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Ctrl-C goes to every process of the terminal; those started in here inherit that they do not hear it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _receive(worker: _Worker[Any]) -> Any:
    try:
        return worker.connection.recv()
    except (EOFError, OSError):  # killed: before, between or amid its bytes
        worker.process.join()
        return WorkerDied(worker.process.exitcode)


def _give_next(worker: _Worker[Task], waiting: list[Task], place: int) -> bool:
    """Send the task at `place` to the worker; False if none is left or the worker has died, so that others take it."""
    if not waiting:
        return False
    try:
        worker.connection.send(waiting[place])
    except OSError:
        return False
    worker.task = waiting.pop(place)
    return True


def _next_place(groups: Sequence[Hashable], own: Sequence[Hashable], others: Sequence[Hashable]) -> int:
    """Return the index of a worker's next task among those that wait, the last of which is next in line.

    groups: of the waiting tasks. own: of the worker's last task, if it had one. others: of the other workers' tasks.
    """
    backwards = range(len(groups) - 1, -1, -1)
    mine = (place for place in backwards if groups[place] in own)
    untouched = (place for place in backwards if groups[place] not in others)
    return next(mine, next(untouched, len(groups) - 1))


def _serve(connection: Connection, make_handler: Callable[[], Callable[[Any], Any]]) -> None:
    """Work on tasks until the other side closes the pipe or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # libraries may have undone the block that it was started with
    threading.Thread(target=_end_with_parent, daemon=True).start()
    use_one_thread()
    get_handler = cache(make_handler)
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        try:
            connection.send(worker_result(get_handler, task))
        except BrokenPipeError:
            return


def _end_with_parent() -> None:
    """A killed parent cannot stop its processes; they would go on for as long as their task takes."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
