"""`dexnudge execute`: the best configurations of a result folder played out, and what happened written beside them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.errors import InputError
from dexnudge.execution.episode import MODEL_FILE, Episode, provenance, slide_grasp_lift, write_model
from dexnudge.execution.executor import Execution, Executor
from dexnudge.execution.slide_grasp_lift import GRASP_DRAWS
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.processes import WorkerDied, run_tasks
from dexnudge.planning.outcomes import Outcome
from dexnudge.results.folder import load_samples, read_inputs, write_summary
from dexnudge.results.samples import Samples
from dexnudge.simulation.model import load_scene_model, scene_model

PUSH_FOLDER, LIFT_FOLDER = "execution", "slide_grasp_lift"  # in the result folder, unless told otherwise


def read_verified(folder: Path) -> tuple[Samples, list[int]]:
    """Read a folder that `sample` wrote, and the places of its verified configurations, best first; at least one.

    Raises:
        InputError: files are missing, damaged or do not belong together, or no configuration is verified.
    """
    samples = load_samples(folder)
    samples.scene.validate()
    if samples.num_verified == 0:
        raise InputError(
            f"{folder}: none of the {len(samples)} configurations is verified; expected at least one; sample again until "
            "one is"
        )
    return samples, np.flatnonzero(samples.success).tolist()


def push_folder(
    folder: Path,
    *,
    top: int = 1,
    workers: int = 1,
    out: Path | None = None,
    overwrite: bool = False,
    films: int = 1,
    on_done: Callable[[int, Execution | WorkerDied], None] | None = None,
) -> dict[str, Any]:
    """Push with the `top` best verified configurations of a folder that `sample` wrote; return the summary.

    Writes scene.xml, trace and film of every configuration and summary.json into `out`, or into folder/execution.

    Args:
        folder: scene, hand and configurations.
        top: how many; fewer where fewer are verified.
        workers: processes.
        out: folder to make.
        overwrite: replace it.
        films: draw film.png and film.gif of this many, best first, which takes some seconds each; film.html is of each.
        on_done: called with each configuration's number and result, as they finish.

    Raises:
        InputError: files are missing, damaged or do not belong together, or no configuration is verified.
        MeshError: MuJoCo cannot take the object or the surroundings.
        OutputError: `out` exists or cannot be written.
    """
    samples, numbers = read_verified(folder)
    chosen = numbers[:top]
    with new_folder(out or folder / PUSH_FOLDER, overwrite=overwrite, marker=MODEL_FILE) as written:
        simulation = scene_model(samples.hand, samples.scene)
        episodes: list[Episode] = []
        rows: list[dict[str, Any]] = []
        tasks = [(index, samples.q[index].astype(np.float64)) for index in chosen]
        handler = partial(_executor, folder.absolute(), simulation.xml)
        for (index, _), result in run_tasks(handler, tasks, workers=min(workers, len(tasks))):
            if isinstance(result, Execution):
                episode = Episode(samples.scene, simulation, result, index)
                title = f"{folder.absolute().name}: configuration {index}"
                episode.write(written, title=title, pictures=chosen.index(index) < films)
                episodes.append(episode)
                row = episode.summary()
            else:
                row = _died(index, result)
            rows.append(row | {"force_margin": samples[index].force_margin})
            if on_done:
                on_done(index, result)
        write_model(episodes, written, xml=simulation.xml)
        succeeded = sum(row["success"] for row in rows)
        summary = {
            "attempted": len(rows),
            "succeeded": succeeded,
            "failed": len(rows) - succeeded,
            "success_rate": succeeded / len(rows),
            "configurations": sorted(rows, key=lambda row: row["configuration"]),
        } | provenance()
        write_summary(written, summary)
    return summary


def _executor(folder: Path, xml: str) -> Callable[[tuple[int, np.ndarray]], Execution]:
    scene, hand = read_inputs(folder)
    executor = Executor(scene, load_scene_model(xml, hand, scene))
    return lambda task: executor(task[1])


def _died(index: int, result: WorkerDied) -> dict[str, Any]:
    outcome = Outcome.WORKER_DIED
    return {
        "configuration": index,
        "success": False,
        "outcome": outcome.value,
        "sentence": outcome.sentence,
        "detail": result.reason,
    }


def lift_folder(
    folder: Path,
    *,
    attempts: int = 3,
    draws: int = GRASP_DRAWS,
    seed: int = 0,
    weights: Path | str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    films: bool = True,
) -> dict[str, Any]:
    """Slide, grasp and lift with the verified configurations of a folder that `sample` wrote; return the summary.

    Writes scene.xml, trace and film of the whole simulation, and summary.json into `out`, or into folder/slide_grasp_lift.

    Args:
        folder: scene, hand and configurations, best first.
        attempts: at most so many.
        draws: of grasps at a time.
        seed: of the grasps.
        weights: folder of the model; None for the one that ships for this hand.
        out: folder to make.
        overwrite: replace it.
        films: whether to draw film.png and film.gif beside film.html, which takes some seconds.

    Raises:
        InputError: files are missing, damaged or do not belong together, or no configuration is verified.
        CheckpointError: no weights for this hand, or weights that are broken or made for another.
        MeshError: MuJoCo cannot take the object or the surroundings.
        OutputError: `out` exists or cannot be written.
    """
    samples, numbers = read_verified(folder)
    with new_folder(out or folder / LIFT_FOLDER, overwrite=overwrite, marker=MODEL_FILE) as written:
        q = samples.q[numbers].astype(np.float64)
        episode = slide_grasp_lift(
            samples.scene,
            samples.hand,
            q,
            np.array(numbers),
            attempts=attempts,
            draws=draws,
            seed=seed,
            weights=weights,
        )
        episode.write(written, title=f"{folder.absolute().name}: slide, grasp, lift", pictures=films)
        write_model([episode], written, xml=episode.simulation.xml)
        options = {"seed": seed, "draws": draws, "most_attempts": attempts}
        summary = episode.summary() | options | provenance()
        write_summary(written, summary)
    return summary
