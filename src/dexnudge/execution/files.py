"""Execute the best configurations of a result folder and write what happened."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Int

from dexnudge.errors import InputError
from dexnudge.execution.executor import Execution, Executor
from dexnudge.execution.film import film_of_trace, film_trace, write_film
from dexnudge.execution.slide_grasp_lift import Story
from dexnudge.hands.hand import Hand
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.processes import WorkerDied, run_tasks
from dexnudge.jobs.provenance import machine, versions
from dexnudge.results.configurations import Configurations, load_configurations
from dexnudge.results.summary import write_summary
from dexnudge.results.writing import read_inputs
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.drive import PHASES
from dexnudge.simulation.episode import Trace
from dexnudge.simulation.push import PushRun, PushVerdict
from dexnudge.simulation.push_model import TIMESTEP, load_push_model, push_model_xml


@dataclass(frozen=True)
class VerifiedFolder:
    """A scene, a hand, its configurations, and which of them are verified, best first; at least one is."""

    scene: Scene
    hand: Hand
    configurations: Configurations
    verified: Int[np.ndarray, " n"]


def read_verified(folder: Path) -> VerifiedFolder:
    """Read a folder that `sample` wrote.

    Raises:
        InputError: files are missing, damaged or do not belong together, or no configuration is verified.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; expected the one that `dexnudge sample --out` wrote")
    configurations = load_configurations(folder)
    scene, hand = read_inputs(folder)
    scene.validate()
    if tuple(hand.joint_names) != configurations.joint_names:
        raise InputError(
            f"{folder}: the configurations have the joints {', '.join(configurations.joint_names)}, the hand in hand/ has "
            f"{', '.join(hand.joint_names)}; expected the same joints in the same order; sample again"
        )
    verified = np.flatnonzero(configurations.success)
    if len(verified) == 0:
        raise InputError(
            f"{folder}: none of the {len(configurations.q)} configurations is verified; expected at least one; sample "
            "again with --verified 1"
        )
    return VerifiedFolder(scene, hand, configurations, verified)


MODEL_FILE = "scene.xml"
KEY_INTERVAL = 0.25  # [s] between two key frames


def trace_file(index: int) -> str:
    """Name of the traces of a configuration."""
    return f"configuration_{index:03d}.npz"


def film_folder(index: int) -> str:
    """Name of the folder with the film of a configuration."""
    return trace_file(index).removesuffix(".npz")


def write_execution(folder: Path, index: int, execution: Execution) -> None:
    """Write the traces of `PushRun` and, if there are any, the approach and the state before a divergence.

    All are npz archives without pickles. `configuration_000.npz`: the arrays of PushRun's records, `phase` as text,
    and of PushForces, by place of the way, `contact_force`, `motor_torque` and `base_wrench`. `..._approach.npz`: a
    `planning.trajectory.Trajectory`.
    `..._diverged.npz`: `state`, MuJoCo's mjSTATE_INTEGRATION at step `step`, from which `diverged_at` is reached.
    """
    run = execution.run
    traces = {
        field.name: getattr(run, field.name)
        for field in dataclasses.fields(PushRun)
        if isinstance(getattr(run, field.name), np.ndarray) and field.name not in ("phase", "last_state")
    }
    traces["phase"] = np.array([PHASES[phase] for phase in run.phase], dtype=np.str_)
    traces["contact_force"] = execution.forces.force
    traces["motor_torque"] = execution.forces.motor_torque
    traces["base_wrench"] = execution.forces.base_wrench
    np.savez_compressed(folder / trace_file(index), **traces)
    stem = film_folder(index)
    if execution.approach.trajectory is not None:
        execution.approach.trajectory.save(folder / f"{stem}_approach.npz")
    if run.diverged_at >= 0:
        np.savez_compressed(
            folder / f"{stem}_diverged.npz", state=run.last_state, step=run.last_step, diverged_at=run.diverged_at
        )


def write_story(folder: Path, index: int, story: Story, xml: str) -> None:
    """Write the trace of a whole story, with the columns of `episode.Trace`, and the model with key frames.

    The names are those that `write_execution` would give to the configuration `index`, with which it began.
    `..._diverged.npz`: `state`, MuJoCo's mjSTATE_INTEGRATION at the last record before a divergence.
    """
    if story.trace is not None:
        np.savez_compressed(folder / trace_file(index), **vars(story.trace))
    if story.last_state is not None:
        stem = film_folder(index)
        np.savez_compressed(folder / f"{stem}_diverged.npz", state=story.last_state)
    write_model(folder, xml, {} if story.trace is None else {index: story.trace})


def write_model(folder: Path, xml: str, runs: Mapping[int, PushRun | Trace]) -> None:
    """Write the model that was simulated, with key frames every 0.25 s of the runs (configuration -> run).

    `python -m mujoco.viewer --mjcf=scene.xml` opens it; its key frames step through what happened.
    """
    root = ElementTree.fromstring(xml)  # noqa: S314 - the text is our own
    keys = ElementTree.SubElement(root, "keyframe")
    for index, run in sorted(runs.items()):
        shown = np.searchsorted(run.time, np.arange(0.0, run.time[-1], KEY_INTERVAL) - 1e-9)
        for record in [*shown, len(run.time) - 1]:
            values = {
                "time": run.time[record],
                "qpos": run.qpos[record],
                "ctrl": run.ctrl[record],
                "mpos": run.mocap[record, :3],
                "mquat": run.mocap[record, 3:],
            }
            key = ElementTree.SubElement(keys, "key", name=f"configuration {index} at {run.time[record]:.2f} s")
            for name, value in values.items():
                key.set(name, " ".join(f"{x:.9g}" for x in np.atleast_1d(value)))
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(folder / MODEL_FILE, encoding="utf-8")


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
    scene, hand = read_inputs(folder)
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
