"""Pictures of rejected draws, drawn again from a row's seed: rows hold verdicts, no hands."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.errors import DexnudgeError, OutputError
from dexnudge.experiments.config import Task
from dexnudge.experiments.row_maker import RowMaker
from dexnudge.experiments.worst_cases import WorstCase
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.hands.hand import Hand
from dexnudge.scenes.scene import Scene

SIZE = (720, 540)  # pixels; several stand on one page


@dataclass(frozen=True)
class RejectedDraw:
    """One rejected draw: its picture, and what the judge found.

    penetration_*: depth [m] in surroundings, object and itself. force_margin, reason, contact_links: as in `Verdicts`.
    deepest_link: whose surface is deepest in surroundings or object; empty where none is inside.
    """

    picture: Path
    reason: str
    penetration_environment: float
    penetration_object: float
    penetration_self: float
    force_margin: float
    contact_links: tuple[str, ...]
    deepest_link: str


def picture_rejected(cases: Sequence[WorstCase], folder: Path) -> list[RejectedDraw | None]:
    """Draws every case again and writes failure-1.png, … into `folder`.

    Of the rejected draws, the best ranked one with the most frequent reason is shown. None where the object cannot be
    read any more, or where other versions of what draws leave nothing rejected.

    Raises:
        OutputError: a picture cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the pictures into {folder}: {error.strerror or error}") from error
    return [_picture(case, folder / f"failure-{number}.png") for number, case in enumerate(cases, start=1)]


def _picture(case: WorstCase, path: Path) -> RejectedDraw | None:
    from dexnudge.viewer.picture import render_png
    from dexnudge.viewer.visual_scene import visual_scene

    row = case.row
    try:
        maker = RowMaker(case.part.config)
        drawn = maker.draw(Task(row.object, row.scene, row.method))
    except DexnudgeError:
        return None  # the row stays as it was counted; only its picture is missing
    verdicts, rejections = drawn.draws.verdicts, drawn.draws.rejections()
    if not rejections:
        return None
    place = verdicts.reasons.index(next(iter(rejections)))
    q = drawn.draws.q[place].astype(np.float64)
    contacts = verdicts.contacts[place].points
    render_png(visual_scene(drawn.scene, maker.hand, q, contacts=contacts), path, size=SIZE)
    return RejectedDraw(
        picture=path,
        reason=verdicts.reasons[place],
        penetration_environment=float(verdicts.penetration_environment[place]),
        penetration_object=float(verdicts.penetration_object[place]),
        penetration_self=float(verdicts.penetration_self[place]),
        force_margin=float(verdicts.force_margin[place]),
        contact_links=tuple(verdicts.contact_links[place]),
        deepest_link=_deepest_link(maker.hand, drawn.scene, q),
    )


def _deepest_link(hand: Hand, scene: Scene, q: Float[np.ndarray, " coordinates"]) -> str:
    dense = hand.dense_points
    T = hand.forward_kinematics(torch.as_tensor(q)[None])[0].numpy()[dense.link]
    points = np.einsum("nij,nj->ni", T[:, :3, :3], dense.points) + T[:, :3, 3]
    solids = [scene.environment_mesh, scene.object_in_world()]
    distance = np.minimum.reduce([ExactDistance(mesh)(points).distance for mesh in solids])
    deepest = int(distance.argmin())
    return hand.link_names[int(dense.link[deepest])] if distance[deepest] < 0.0 else ""
