"""The engines that run tasks: processes of this machine, or a Ray cluster."""

from collections.abc import Callable, Generator, Hashable, Sequence
from typing import Literal, TypeVar

from dexnudge.errors import InputError
from dexnudge.jobs.processes import WorkerDied, run_tasks
from dexnudge.jobs.ray_cluster import run_tasks_on_ray

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
