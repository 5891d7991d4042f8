"""The failures that a report shows: where a method does worst, for which reasons, and a rejected draw in a picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dexnudge.errors import DexnudgeError, OutputError
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.sampling_records import Records, SamplingRecord
from dexnudge.experiments.tables import Table, method_name
from dexnudge.experiments.trial import Section
from dexnudge.experiments.trial_sampler import TrialSampler
from dexnudge.verification.criteria import PENETRATION_LIMIT, SUCCESS_MARGIN

MOST_CASES = 3
SIZE = (720, 540)  # pixels; several stand on one page
ABOUT = (
    "Where dexnudge verifies the smallest share of its draws, one case from each scene first. In the pictures: yellow, "
    "where hand and object touch; green, the motion; the grey box is the forearm."
)


@dataclass(frozen=True)
class WorstCase:
    """An object and scene in which many draws of a method fail: the experiment, and the record."""

    config: ExperimentConfig
    record: SamplingRecord


def worst_cases(experiments: Sequence[tuple[ExperimentConfig, Records]], method: str) -> list[WorstCase]:
    """Return the records of a method with the smallest share of verified draws, worst first; at most `MOST_CASES`.

    No two are from the same scene as long as there are others. Neither a record without a rejected draw is taken nor that
    of a failed object, which has no draws.
    """
    found = [
        WorstCase(config, record)
        for config, records in experiments
        for record in records
        if record.method == method and not all(record.success)
    ]
    found.sort(key=lambda case: case.record.verified / case.record.num)
    first_of_scene: dict[str, WorstCase] = {}
    for case in found:
        first_of_scene.setdefault(case.record.scene, case)
    chosen = list(first_of_scene.values())
    return (chosen + [case for case in found if case not in chosen])[:MOST_CASES]


def failure_sections(cases: Sequence[WorstCase], folder: Path) -> list[Section]:
    """Draw every case again and return its section; the pictures failure-1.png and on go into `folder`.

    Raises:
        OutputError: a picture cannot be written.
    """
    if not cases:
        return [Section("Failures", "No draw of dexnudge was rejected.")]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the pictures into {folder}: {error.strerror or error}") from error
    sections = [Section("Worst cases", ABOUT)]
    for number, case in enumerate(cases, start=1):
        record, path = case.record, folder / f"failure-{number}.png"
        text = picture_rejected(case, path)
        title = (
            f"{record.object}, {record.scene}: {record.verified} of {record.num} draws of {method_name(record.method)}"
        )
        reasons = Table(["reason", "draws"], list(record.rejected.items()), labels=1)
        picture = f"{text}\n\n![A rejected draw]({folder.name}/{path.name})" if text else ""
        sections.append(Section(title, picture, reasons))
    return sections


def picture_rejected(case: WorstCase, path: Path) -> str:
    """Draw a case again, write the picture of its best ranked draw with the most frequent reason, and describe it.

    Returns "" where the object cannot be read any more, or where other versions of what draws leave nothing rejected.
    """
    from dexnudge.viewer.picture import render_png
    from dexnudge.viewer.visual_scene import visual_scene

    try:
        sampler = TrialSampler(case.config)
        drawn = sampler.draw(case.record.key)
    except DexnudgeError:
        return ""  # the record stays as it was counted; only its picture is missing
    verdicts, rejections = drawn.samples.verdicts, drawn.samples.rejections()
    if not rejections:
        return ""
    reason = next(iter(rejections))
    place = verdicts.reasons.index(reason)
    q = drawn.samples.q[place].astype(np.float64)
    render_png(visual_scene(drawn.scene, sampler.hand, q, contacts=verdicts.contacts[place].points), path, size=SIZE)
    penetrations = {
        "surroundings": verdicts.penetration_environment,
        "object": verdicts.penetration_object,
        "hand itself": verdicts.penetration_self,
    }
    depths = ", ".join(f"{1e3 * depth[place]:.2f} mm in {where}" for where, depth in penetrations.items())
    links = ", ".join(verdicts.contact_links[place]) or "none"
    return (
        f"A rejected draw, {reason}: {verdicts.sentences.get(reason, reason)}. Depth {depths}, "
        f"{1e3 * PENETRATION_LIMIT:g} mm is allowed; links in contact: {links}; "
        f"force margin {verdicts.force_margin[place]:.2f}, {SUCCESS_MARGIN:g} is needed."
    )
