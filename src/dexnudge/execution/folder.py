"""`dexnudge execute`: the best configurations of a result folder played out, and what happened written beside them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.execution.episode import EPISODE_FILES, MODEL_FILE, Episode, execute, provenance, write_model
from dexnudge.execution.episode_files import ARRAYS
from dexnudge.execution.executor import Execution, Executor, chosen_policy, distinct_pushes
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.processes import run_tasks
from dexnudge.planning.outcomes import Outcome
from dexnudge.results.folder import load_samples, read_inputs, subject, write_summary
from dexnudge.results.samples import Samples
from dexnudge.simulation.model import load_scene_model, scene_model

PUSH_FOLDER, LIFT_FOLDER = "execution", "slide_grasp_lift"  # in the result folder, unless told otherwise


def read_verified(folder: Path) -> Samples:
    """Return the verified configurations of a folder that `sample` wrote, best first; at least one.

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
    return samples.verified


def push_folder(
    folder: Path,
    *,
    top: int = 1,
    feedback: bool = True,
    workers: int = 1,
    out: Path | None = None,
    overwrite: bool = False,
    films: int = 1,
    on_progress: Callable[[int, int, dict[str, Any] | None], None] | None = None,
) -> dict[str, Any]:
    """Push with the `top` best verified configurations of a folder that `sample` wrote; return the summary.

    Writes scene.xml, episode.npz, episode.json and film of every configuration, each in a folder of its own, and
    summary.json into `out`, or into folder/execution. Of the `films` best also film.png and film.gif are drawn, which takes
    some seconds each. `on_progress` is called with how many are done, with how many there are, and with the summary's row of
    the last one; at first with 0 and None.

    Raises:
        InputError: files are missing, damaged or do not belong together, or no configuration is verified.
        MeshError: MuJoCo cannot take the object or the surroundings.
        OutputError: `out` exists or cannot be written.
    """
    verified = read_verified(folder)
    samples, of = verified[:top], subject(folder, verified)
    out = out or folder / PUSH_FOLDER
    with new_folder(out, overwrite=overwrite, marker=MODEL_FILE, ours=EPISODE_FILES) as written:
        simulation = scene_model(samples.hand, samples.scene)
        episodes: list[Episode] = []
        rows: list[dict[str, Any]] = []
        tasks = list(enumerate(samples.q.astype(np.float64)))
        handler = partial(
            _executor, folder.absolute(), simulation.xml, verified.q.astype(np.float64), feedback=feedback
        )
        if on_progress:
            on_progress(0, len(tasks), None)
        for (index, _), result in run_tasks(handler, tasks, workers=min(workers, len(tasks))):
            if isinstance(result, Execution):
                policy = type(chosen_policy(feedback)).__name__
                episode = Episode(samples.scene, simulation, result, policy, index)
                title = f"{of}: configuration {index}"
                own = f"configuration_{index:03d}"
                episode.write(written / own, title=title, pictures=index < films)
                episodes.append(episode)
                row = episode.summary() | {"trace": f"{own}/{ARRAYS}"}
            else:
                died = Outcome.WORKER_DIED
                row = {"configuration": index, "success": False, "outcome": died.value}
                row |= {"sentence": died.sentence, "detail": result.reason}
            rows.append(row | {"force_margin": samples[index].force_margin})
            if on_progress:
                on_progress(len(rows), len(tasks), rows[-1])
        write_model({episode.configuration: episode.trace for episode in episodes}, written, xml=simulation.xml)
        whole = samples.scene.object_motion.slide_length
        summary = {"verified": len(verified), "motion_length": whole} | counts(rows) | provenance()
        write_summary(written, summary)
    return summary


def counts(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how many pushes succeeded and failed, and the rows in order, each with `counted`.

    repeated: configurations whose push began with one that is counted already, as no free way leads to them or as they did
    not hold when rehearsed; they are neither among those that succeeded nor among those that failed.
    """
    rows = sorted(rows, key=lambda row: row["configuration"])
    pushes = distinct_pushes(row.get("began_with", row["configuration"]) for row in rows)
    succeeded = sum(rows[place]["success"] for place in pushes)
    return {
        "attempted": len(rows),
        "succeeded": succeeded,
        "failed": len(pushes) - succeeded,
        "repeated": len(rows) - len(pushes),
        "success_rate": succeeded / len(pushes),
        "configurations": [row | {"counted": place in pushes} for place, row in enumerate(rows)],
    }


def _executor(
    folder: Path, xml: str, q: Float[np.ndarray, "n coordinates"], *, feedback: bool
) -> Callable[[tuple[int, np.ndarray]], Execution]:
    scene, hand = read_inputs(folder)
    executor = Executor(scene, load_scene_model(xml, hand, scene), chosen_policy(feedback))
    return lambda task: executor(task[1], np.delete(q, task[0], axis=0) if feedback else None)


def lift_folder(
    folder: Path,
    *,
    feedback: bool = True,
    attempts: int = 3,
    seed: int = 0,
    weights: Path | str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    films: bool = True,
) -> dict[str, Any]:
    """Slide, grasp and lift with the verified configurations of a folder that `sample` wrote; return the summary.

    Writes scene.xml, episode.npz, episode.json, the film and summary.json into `out`, or into folder/slide_grasp_lift.

    See `execute` for `attempts`, `seed` and `weights`; `films`: draw film.png and film.gif beside film.html.

    Raises:
        InputError, MeshError, OutputError: as `push_folder`.
        CheckpointError: no weights for this hand, or weights that are broken or made for another.
    """
    verified = read_verified(folder)
    first, *others = verified
    out = out or folder / LIFT_FOLDER
    with new_folder(out, overwrite=overwrite, marker=MODEL_FILE, ours=EPISODE_FILES) as written:
        episode = execute(
            first,
            feedback=feedback,
            then_grasp=True,
            alternatives=others,
            attempts=attempts,
            seed=seed,
            weights=weights,
        )
        title, options = f"{subject(folder, verified)}: slide, grasp, lift", {"seed": seed, "most_attempts": attempts}
        return episode.write_all(written, title=title, pictures=films, details=options)
