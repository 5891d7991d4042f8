"""Write the folder of `sample`: first the problem, then, judged from those files, the answer."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.hands.export import export_hand
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, peak_memory_mb, versions
from dexnudge.results.configurations import Configurations
from dexnudge.results.samples import Samples
from dexnudge.results.summary import count_draws, write_summary
from dexnudge.scenes.files import load_scene, save_scene
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts, contact_points

HAND_FOLDER = "hand"
URDF_FILE = "hand.urdf"
PAGE_FILE, PICTURE_FILE = "view.html", "view.png"
MOST_ON_PAGE = 500  # what a page can show
SHOWN_VALUES = ("penetration_object", "penetration_environment", "penetration_self", "force_margin")  # by the page


def write_inputs(folder: Path, scene: Scene, hand: Hand) -> tuple[Scene, Hand]:
    """Write scene and hand into `folder` and return them as read back.

    What is read back is what draws are judged with: then the verdicts are those of the files, rounding included, and
    `check` finds the same.
    """
    save_scene(scene, folder)
    export_hand(hand, folder / HAND_FOLDER)
    return read_inputs(folder)


def read_inputs(folder: Path) -> tuple[Scene, Hand]:
    """Scene and hand of a result folder.

    Raises:
        InputError: a file is missing, damaged, or points outside the folder.
    """
    return load_scene(folder), load_hand(str(folder / HAND_FOLDER / URDF_FILE))


def as_configurations(q: Float[np.ndarray, "n coordinates"], verdicts: Verdicts, hand: Hand) -> Configurations:
    """Configurations and their verdicts as the arrays of configurations.npz."""
    return Configurations(
        q=q,
        joint_names=tuple(hand.joint_names),
        success=verdicts.success,
        penetration_object=verdicts.penetration_object,
        penetration_environment=verdicts.penetration_environment,
        penetration_self=verdicts.penetration_self,
        force_margin=verdicts.force_margin,
        contact_links=tuple(tuple(links) for links in verdicts.contact_links),
    )


def write_results(
    folder: Path,
    scene: Scene,
    hand: Hand,
    draws: Samples,
    *,
    title: str,
    seconds: dict[str, float],
    details: dict[str, Any],
) -> dict[str, Any]:
    """Write configurations, page, picture and summary beside the problem; return the summary.

    Args:
        folder: where `write_inputs` wrote.
        scene: as `write_inputs` returned it.
        hand: the same.
        draws: in ranked order.
        title: plain text above page and picture.
        seconds: of the stages before the first draw; those of drawing and writing are added.
        details: further entries of the summary, such as the options of the run.
    """
    configurations = as_configurations(draws.q, draws.verdicts, hand)
    configurations.save(folder)
    seconds = {**seconds, **draws.seconds}
    start = time.perf_counter()
    write_views(folder, scene, hand, draws, title=title)
    seconds["picture"] = time.perf_counter() - start
    summary = {
        **count_draws(configurations, draws.rejections()),
        **details,
        "seconds": {stage: round(value, 4) for stage, value in seconds.items()},
        "seconds_total": round(sum(seconds.values()), 4),
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "machine": machine(),
        "versions": versions(),
        "sampler": list(draws.reports),
    }
    write_summary(folder, summary)
    return summary


def write_views(folder: Path, scene: Scene, hand: Hand, draws: Samples, *, title: str) -> None:
    """Write the 3-D page with all draws, and the picture of the best one."""
    from dexnudge.viewer.page import Figures, write_page
    from dexnudge.viewer.picture import render_png
    from dexnudge.viewer.visual_scene import drawings

    verdicts = draws.verdicts
    shown = draws.q[:MOST_ON_PAGE].astype(np.float64)
    figures = [
        Figures(
            success=bool(verdicts.success[i]),
            values={name: float(getattr(verdicts, name)[i]) for name in SHOWN_VALUES},
            contact_links=tuple(verdicts.contact_links[i]),
            reason=verdicts.reason[i],
        )
        for i in range(len(shown))
    ]
    drawn = drawings(scene, hand, shown, contacts=contact_points(hand, scene, shown), title=title)
    write_page(drawn, folder / PAGE_FILE, title=title, figures=figures)
    render_png(drawn[0], folder / PICTURE_FILE)
