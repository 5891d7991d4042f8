"""Write and read a result folder: scene and hand first, then what was drawn, as verified from those files."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.errors import InputError
from dexnudge.hands.export import export_hand
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.provenance import machine, peak_memory_mb, versions
from dexnudge.results.configurations import FILE, Configurations, load_configurations
from dexnudge.results.samples import Samples
from dexnudge.results.summary import count_draws, criteria_by_name, read_summary, write_summary
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import missing_criteria
from dexnudge.verification.verdicts import Verdicts, contacts_of, verify

HAND_FOLDER = "hand"
URDF_FILE = "hand.urdf"
PAGE_FILE, PICTURE_FILE = "view.html", "view.png"


def write_inputs(folder: Path, scene: Scene, hand: Hand) -> tuple[Scene, Hand]:
    """Write scene and hand into `folder` and return them as read back.

    What is read back is what draws are verified with: then the verdicts are those of the files, rounding included, and
    `check` finds the same.
    """
    scene.save(folder)
    export_hand(hand, folder / HAND_FOLDER)
    return read_inputs(folder)


def read_inputs(folder: Path) -> tuple[Scene, Hand]:
    """Return scene and hand of a result folder.

    Raises:
        InputError: a file is missing, damaged, or points outside the folder.
    """
    return Scene.load(folder), load_hand(str(folder / HAND_FOLDER / URDF_FILE))


def as_configurations(samples: Samples) -> Configurations:
    """Return the arrays of configurations.npz."""
    verdicts = samples.verdicts
    return Configurations(
        q=samples.q,
        joint_names=tuple(samples.hand.joint_names),
        success=verdicts.success,
        reasons=tuple(verdicts.reasons),
        values=verdicts.values,
        contact_links=tuple(tuple(links) for links in verdicts.contact_links),
    )


def write_results(
    folder: Path, samples: Samples, *, title: str, seconds: dict[str, float], details: dict[str, Any]
) -> dict[str, Any]:
    """Write configurations, page, picture and summary beside scene and hand; return the summary.

    Args:
        folder: where `write_inputs` wrote.
        samples: verified with the scene and the hand that `write_inputs` returned.
        title: plain text above page and picture.
        seconds: of the stages before the first draw; those of drawing and writing are added.
        details: further entries of the summary, such as the options of the run.
    """
    configurations = as_configurations(samples)
    configurations.save(folder)
    start = time.perf_counter()
    samples.page(folder / PAGE_FILE, title=title)
    samples.picture(folder / PICTURE_FILE)
    seconds = {**seconds, **samples.seconds, "picture": time.perf_counter() - start}
    summary = {
        **count_draws(configurations, samples.rejections()),
        "reasons": {reason: samples.verdicts.sentences[reason] for reason in samples.rejections()},
        "criteria": list(samples.verdicts.values),
        **details,
        "seconds": {stage: round(value, 4) for stage, value in seconds.items()},
        "seconds_total": round(sum(seconds.values()), 4),
        "peak_memory_mb": round(peak_memory_mb(), 1),
        "machine": machine(),
        "versions": versions(),
        "sampler": list(samples.reports),
    }
    write_summary(folder, summary)
    return summary


def save_samples(samples: Samples, out: Path, *, title: str, overwrite: bool) -> Samples:
    """Write the folder of `Samples.save`; return the samples as written."""
    if not len(samples):
        raise InputError("there are no samples to save; expected at least one")
    criteria = {criterion.name: criterion for criterion in samples.verdicts.criteria}
    missing = missing_criteria(criteria) + [name for name in samples.verdicts.values if name not in criteria]
    if missing:
        raise InputError(
            f"the samples cannot be verified again by {', '.join(missing)}; expected all built-in criteria, and those of "
            "your own installed; verify them again by criteria that are at hand"
        )
    with new_folder(out, overwrite=overwrite, marker=FILE) as folder:
        scene, hand = write_inputs(folder, samples.scene, samples.hand)
        verdicts = verify(scene, hand, samples.q, samples.verdicts.criteria)
        written = replace(samples, scene=scene, hand=hand, verdicts=verdicts)
        written = written[np.argsort(~verdicts.success, kind="stable")]
        title = title or f"{hand.name}, {scene.name}"
        write_results(folder, written, title=title, seconds={}, details={"scene": scene.name, "hand": hand.name})
    return written


def read_samples(folder: Path) -> Samples:
    """Read a result folder; InputError when a file is missing, damaged, or does not belong to the others."""
    found = load_configurations(folder)
    summary = read_summary(folder)
    scene, hand = read_inputs(folder)
    check_joints(folder, found, hand)
    criteria, _ = criteria_by_name(folder, summary, found)
    verdicts = Verdicts(
        success=found.success,
        reasons=list(found.reasons),
        values=found.values,
        contacts=contacts_of(scene, hand, found.q),
        contact_links=[list(links) for links in found.contact_links],
        sentences=dict(summary.get("reasons", {})),
        criteria=tuple(criteria.values()),
    )
    seconds = dict(summary.get("seconds", {}))
    return Samples(scene, hand, found.q, verdicts, seconds=seconds, reports=tuple(summary.get("sampler", ())))


def check_joints(folder: Path, configurations: Configurations, hand: Hand) -> None:
    """Refuse configurations of another hand; InputError."""
    if tuple(hand.joint_names) != configurations.joint_names:
        raise InputError(
            f"{folder}: the configurations have the joints {', '.join(configurations.joint_names)}, the hand in hand/ "
            f"has {', '.join(hand.joint_names)}; expected the same joints in the same order; sample again"
        )
