"""Execute the best configurations of a result folder and write what happened."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.evaluation.provenance import machine, versions
from dexnudge.execution.executor import Execution, Executor
from dexnudge.execution.files import MODEL_FILE, film_folder, write_execution, write_model
from dexnudge.execution.film import film_of_trace, film_trace, write_film
from dexnudge.execution.verified import read_verified
from dexnudge.jobs.answers import WorkerDied
from dexnudge.jobs.processes import run_tasks
from dexnudge.results.configurations import Configurations
from dexnudge.results.new_folder import new_folder
from dexnudge.results.summary import write_summary
from dexnudge.results.writing import read_problem
from dexnudge.simulation.push_model import TIMESTEP, load_push_model, push_model_xml
from dexnudge.simulation.push_verdict import PushVerdict

FOLDER = "execution"  # in the result folder, unless told otherwise


def execute_folder(
    folder: Path,
    *,
    top: int = 1,
    workers: int = 1,
    out: Path | None = None,
    overwrite: bool = False,
    films: int = 1,
    on_done: Callable[[int, Execution | WorkerDied], None] | None = None,
) -> dict[str, Any]:
    """Execute the `top` best verified configurations of a folder that `sample` wrote; return the summary.

    Writes scene.xml, the traces and film of every configuration and summary.json into `out`, or into folder/execution.

    Args:
        folder: scene, hand and configurations.
        top: how many; fewer where fewer are verified.
        workers: processes.
        out: folder to make.
        overwrite: replace it.
        films: draw film.png and film.gif of this many, best first, which takes some seconds each; film.html is of each.
        on_done: called with each configuration's index and outcome, as they finish.

    Raises:
        InputError: files are missing, damaged or do not belong together, or no configuration is verified.
        MeshError: MuJoCo cannot take the object or the surroundings.
        OutputError: `out` exists or cannot be written.
    """
    found = read_verified(folder)
    scene, hand, configurations = found.scene, found.hand, found.configurations
    chosen = found.verified[:top].tolist()
    with new_folder(out or folder / FOLDER, overwrite=overwrite, marker=MODEL_FILE) as written:
        xml = push_model_xml(hand, scene)
        push = load_push_model(xml, hand, scene)
        outcomes: dict[int, Execution | WorkerDied] = {}
        tasks = [(index, configurations.q[index].astype(np.float64)) for index in chosen]
        workers = min(workers, len(tasks))
        for (index, _), outcome in run_tasks(partial(_handler, folder.absolute(), xml), tasks, workers=workers):
            outcomes[index] = outcome
            if isinstance(outcome, Execution):
                write_execution(written, index, outcome)
                film = film_of_trace(
                    scene,
                    push,
                    film_trace(outcome.run),
                    title=f"{folder.absolute().name}: configuration {index}",
                    subtitle=_figures(outcome.verdict),
                )
                write_film(film, written / film_folder(index), pictures=chosen.index(index) < films)
            if on_done:
                on_done(index, outcome)
        runs = {index: outcome.run for index, outcome in outcomes.items() if isinstance(outcome, Execution)}
        write_model(written, xml, runs)
        summary = _summary(outcomes, configurations)
        write_summary(written, summary)
    return summary


def _handler(folder: Path, xml: str) -> Callable[[tuple[int, np.ndarray]], Execution]:
    scene, hand = read_problem(folder)
    executor = Executor(hand, scene, xml)
    return lambda task: executor(task[1])


def _figures(verdict: PushVerdict) -> str:
    outcome = verdict.reason or "success"
    return f"{outcome}; {1e3 * verdict.advanced:.0f} mm along the motion, turned {verdict.turned_deg:.0f} deg"


def _summary(outcomes: dict[int, Execution | WorkerDied], configurations: Configurations) -> dict[str, Any]:
    rows = [_row(index, outcomes[index], float(configurations.force_margin[index])) for index in sorted(outcomes)]
    succeeded = sum(row["success"] for row in rows)
    return {
        "attempted": len(rows),
        "succeeded": succeeded,
        "failed": len(rows) - succeeded,
        "success_rate": succeeded / len(rows),
        "timestep": TIMESTEP,
        "configurations": rows,
        "machine": machine(),
        "versions": versions(),
    }


def _row(index: int, outcome: Execution | WorkerDied, margin: float) -> dict[str, Any]:
    if isinstance(outcome, WorkerDied):
        return {"configuration": index, "force_margin": margin, "success": False, "reason": outcome.reason}
    verdict: PushVerdict = outcome.verdict
    blocked = outcome.approach.blocked
    return {
        "configuration": index,
        "force_margin": margin,
        **asdict(verdict),
        "hand_environment_exact": outcome.exact_environment,
        "approach": outcome.approach.planner if blocked is None else f"none, starts at contact: {blocked.reason}",
        "cone_share": float(outcome.forces.cone_share[0]),
        "diverged_at": outcome.run.diverged_at,
        "simulated_seconds": float(outcome.run.time[-1]),
        "seconds": {stage: round(value, 4) for stage, value in outcome.seconds.items()},
    }
