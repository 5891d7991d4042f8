"""The failures that a report shows: where a method does worst, for which reasons, and a rejected draw in a picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dexnudge.errors import DexnudgeError, writing
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.drawn_trial import TrialSampler
from dexnudge.experiments.sampling_records import Records, SamplingRecord
from dexnudge.experiments.tables import Table
from dexnudge.experiments.trial import Section
from dexnudge.verification.criteria import PENETRATION_LIMIT, SUCCESS_MARGIN

MOST_CASES = 3
SIZE = (720, 540)  # pixels; several stand on one page
ABOUT = (
    "Where the smallest share of draws is verified, one case from each scene first. In the pictures: yellow, "
    "where hand and object touch; green, the motion; the grey box is the forearm."
)


Case = tuple[ExperimentConfig, SamplingRecord]
"""An object and scene in which many draws of a method fail: the experiment, and the record."""


def worst_cases(experiments: Sequence[tuple[ExperimentConfig, Records]], method: str) -> list[Case]:
    """Return the records of a method with the smallest share of verified draws, worst first; at most `MOST_CASES`.

    No two are from the same scene as long as there are others. Neither a record without a rejected draw is taken nor that
    of a failed object, which has no draws.
    """
    found = [
        (config, record)
        for config, records in experiments
        for record in records
        if record.method == method and not all(record.success)
    ]
    found.sort(key=lambda case: case[1].verified / case[1].num)
    first_of_scene: dict[str, Case] = {}
    for case in found:
        first_of_scene.setdefault(case[1].scene, case)
    chosen = list(first_of_scene.values())
    return (chosen + [case for case in found if case not in chosen])[:MOST_CASES]


def failure_sections(cases: Sequence[Case], folder: Path) -> list[Section]:
    """Draw every case again and return its section; the pictures failure-1.png and on go into `folder`.

    Raises:
        OutputError: a picture cannot be written.
    """
    if not cases:
        return [Section("Failures", "No draw was rejected.")]
    with writing(f"the pictures into {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
    sections = [Section("Worst cases", ABOUT)]
    for number, (config, record) in enumerate(cases, start=1):
        path, share = folder / f"failure-{number}.png", f"{record.verified} of {record.num} draws"
        text = picture_rejected(config, record, path)
        title = f"{record.object}, {record.scene}: {share} of {record.method}"
        reasons = Table(["reason", "draws"], list(record.rejected.items()), labels=1)
        picture = f"{text}\n\n![A rejected draw]({folder.name}/{path.name})" if text else ""
        sections.append(Section(title, picture, reasons))
    return sections


def picture_rejected(config: ExperimentConfig, record: SamplingRecord, path: Path) -> str:
    """Draw a case again, write the picture of its best ranked draw with the most frequent reason, and describe it.

    Returns "" where the object cannot be read any more, or where other versions of what draws leave nothing rejected.
    """
    from dexnudge.viewer.picture import render_png
    from dexnudge.viewer.visual_scene import visual_scenes

    try:
        samples = TrialSampler(config).draw(record.key)
    except DexnudgeError:
        return ""  # the record stays as it was counted; only its picture is missing
    if samples.num_verified == len(samples):
        return ""
    reason = next(iter(samples.rejections()))
    rejected = samples[samples.reasons.index(reason)]
    q = rejected.q[None].astype(np.float64)
    shown = visual_scenes(rejected.scene, rejected.hand, q, contacts=[rejected.contacts.points])
    render_png(shown[0], path, size=SIZE)
    depths = ", ".join(
        f"{1e3 * rejected.values[f'penetration_{name}']:.2f} mm in {where}"
        for name, where in (("environment", "surroundings"), ("object", "object"), ("self", "hand itself"))
    )
    return (
        f"A rejected draw, {reason}: {samples.verdicts.sentences.get(reason, reason)}. Depth {depths}, "
        f"{1e3 * PENETRATION_LIMIT:g} mm is allowed; links in contact: {', '.join(rejected.contact_links) or 'none'}; "
        f"force margin {rejected.force_margin:.2f}, {SUCCESS_MARGIN:g} is needed."
    )
