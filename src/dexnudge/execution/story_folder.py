"""Slide, grasp and lift the object of a result folder, and write what happened."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.execution.files import MODEL_FILE, film_folder, read_verified, trace_file, write_story
from dexnudge.execution.film import film_of_trace, film_trace, write_film
from dexnudge.execution.grasp_and_lift import HOLD_TIME, LIFT
from dexnudge.execution.slide_grasp_lift import GRASP_DRAWS, SlideGraspLift, Story
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.provenance import machine, versions
from dexnudge.results.summary import write_summary
from dexnudge.sampling.sampler import Sampler
from dexnudge.simulation.push_model import TIMESTEP, load_push_model, push_model_xml

FOLDER = "slide_grasp_lift"  # in the result folder, unless told otherwise


def slide_grasp_lift_folder(
    folder: Path,
    *,
    tries: int = 3,
    draws: int = GRASP_DRAWS,
    seed: int = 0,
    weights: Path | str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    films: bool = True,
) -> dict[str, Any]:
    """Play slide, grasp and lift with the verified configurations of a folder that `sample` wrote; return the summary.

    Writes scene.xml, trace and film of the whole simulation, and summary.json into `out`, or into folder/slide_grasp_lift.

    Args:
        folder: scene, hand and configurations, best first.
        tries: at most so many.
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
    found = read_verified(folder)
    sampler = Sampler.from_pretrained(found.hand, weights=weights)
    with new_folder(out or folder / FOLDER, overwrite=overwrite, marker=MODEL_FILE) as written:
        xml = push_model_xml(found.hand, found.scene)
        q = found.configurations.q[found.verified].astype(np.float64)
        runner = SlideGraspLift(found.hand, found.scene, xml, q, found.verified, sampler, draws=draws, seed=seed)
        story = runner.run(tries)
        index = next((one.configuration for one in story.tries if one.configuration >= 0), int(found.verified[0]))
        write_story(written, index, story, xml)
        if story.trace is not None:
            film = film_of_trace(
                found.scene,
                load_push_model(xml, found.hand, found.scene),
                film_trace(story.trace),
                title=f"{folder.absolute().name}: slide, grasp, lift",
                subtitle=story.tries[-1].reason or "lifted and held",
            )
            write_film(film, written / film_folder(index), pictures=films)
        summary = story_summary(story, trace=trace_file(index))
        summary.update(seed=seed, draws=draws, most_tries=tries)
        write_summary(written, summary)
    return summary


def story_summary(story: Story, *, trace: str) -> dict[str, Any]:
    """Verdicts of all tries; `success_first_try` is what there is without retries."""
    return {
        "success": story.tries[-1].success,
        "success_first_try": story.tries[0].success,
        "reason": story.tries[-1].reason,
        "ended": story.ended,
        "tries": [{"success": one.success, **asdict(one)} for one in story.tries],
        "trace": trace if story.trace is not None else None,
        "simulated_seconds": 0.0 if story.trace is None else float(story.trace.time[-1]),
        "lift": LIFT,
        "hold_seconds": HOLD_TIME,
        "timestep": TIMESTEP,
        "machine": machine(),
        "versions": versions(),
    }
