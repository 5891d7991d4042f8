"""What an execution leaves behind: a model with key frames for MuJoCo's viewer, traces, and what is needed to replay."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dexnudge.execution.executor import Execution
from dexnudge.execution.story import Story
from dexnudge.simulation.drive import PHASES
from dexnudge.simulation.episode import Trace
from dexnudge.simulation.push import PushRun

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
