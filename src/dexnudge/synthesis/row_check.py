"""Verifies rows of one object again: from its mesh and the stored numbers, by the exact path."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.shards import Shard, read_shard
from dexnudge.errors import DatasetError
from dexnudge.hands.registry import load_hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.objects.sets import ObjectEntry
from dexnudge.simulation.object_motion import FARTHEST, MOST_TURNED
from dexnudge.synthesis.object_data import at_rest
from dexnudge.synthesis.object_task import mesh_hash
from dexnudge.synthesis.verification import (
    GraspVerifier,
    NonPrehensileVerifier,
    Verified,
    floating_scene,
    resting_scene,
)

PENETRATION_TOLERANCE = 1e-4  # [m] the same query on another machine; a tenth of what decides
MARGIN_TOLERANCE = 2e-3  # the same solver on another machine, and the rounding of what is stored; no unit
CONTACT_TOLERANCE = 1e-4  # [m] thirteen times the rounding of what is stored, a twentieth of what counts as contact
# That a grasp holds must come out again. How far the object drifts is the same number on the same machine; on another
# one sums end in other last digits, and contacts that slip amplify them: changes of 1e-12 to 1e-6 in q and contacts moved
# drifts by up to 0.15 mm and 0.003 rad. This share of what decides is 2.5 mm and 0.013 rad.
DRIFT_SHARE = 0.05
BATCH = 256  # rows verified together: what memory a worker needs does not grow with the shard


@dataclass(frozen=True)
class RowCheckTask:
    """The rows of one object that are verified again; mesh_hash is of the mesh that they were generated from."""

    entry: ObjectEntry
    mesh_hash: str
    rows: Int[np.ndarray, " picked"]


class RowCheck:
    """Verifies the rows of one object after another, with the hand loaded once."""

    def __init__(self, folder: Path, manifest: Manifest, hand: str) -> None:
        self._folder = folder
        self._manifest = manifest
        self._hand = load_hand(hand)

    def __call__(self, task: RowCheckTask) -> list[str]:
        """Every difference between the shard and what is found now, in words.

        Raises:
            DatasetError: the mesh is another one; the shard is damaged.
        """
        mesh = task.entry.load()
        if mesh_hash(mesh) != task.mesh_hash:
            raise DatasetError(
                f"the mesh of {task.entry.name!r} is not the one that the dataset was generated from; mend --objects"
            )
        mesh = at_rest(mesh)
        shard = read_shard(self._folder, self._manifest, task.entry.name)
        grasps = np.array([label == "grasp" for label in shard.table.column("behaviour").to_pylist()], dtype=bool)
        differences = []
        for rows, verifier in (
            (task.rows[~grasps[task.rows]], lambda: NonPrehensileVerifier(self._hand, resting_scene(mesh))),
            (task.rows[grasps[task.rows]], lambda: GraspVerifier(self._hand, floating_scene(mesh))),
        ):
            if len(rows):
                differences += _compare(shard, rows, verifier())
        return differences


def _compare(
    shard: Shard, rows: Int[np.ndarray, " picked"], verify: Callable[[Float[np.ndarray, "n coordinates"]], Verified]
) -> list[str]:
    q = shard.column_matrix("q").astype(np.float64)
    differences = []
    for start in range(0, len(rows), BATCH):
        batch = rows[start : start + BATCH]
        found = verify(q[batch])
        for place, (row, stored) in enumerate(zip(batch, shard.table.take(batch).to_pylist(), strict=True)):
            label = f"{shard.object_name}, row {row}"
            if found.reason[place]:
                differences.append(f"{label}: kept in the file, found to be rejected for {found.reason[place]}")
            else:
                differences += [f"{label}: {difference}" for difference in _row_differences(stored, found, place)]
    return differences


def _row_differences(stored: dict[str, Any], found: Verified, place: int) -> list[str]:
    """Where the columns of one row differ from the verdict at `place`."""
    depths = [stored[f"penetration_{what}"] for what in ("object", "environment", "self")]
    differences = _numbers("penetration", depths, found.penetration[place], PENETRATION_TOLERANCE)
    differences += _numbers(
        "direction_margin", stored["direction_margin"], found.direction_margin[place], MARGIN_TOLERANCE
    )
    links, points = tuple(stored["contact_links"]), _contact_points(found.contacts[place])
    if links != found.contact_links(place):
        differences.append(f"contact_links are {links} in the file, {found.contact_links(place)} found")
    elif len(stored["contact_points"]) != len(links):
        differences.append(f"{len(stored['contact_points'])} contact_points in the file, {len(links)} found")
    else:
        differences += _numbers("contact_points", stored["contact_points"], points, CONTACT_TOLERANCE)
    differences += _numbers(
        "hold_translation", stored["hold_translation"], found.hold_translation[place], DRIFT_SHARE * FARTHEST
    )
    differences += _numbers(
        "hold_rotation", stored["hold_rotation"], found.hold_rotation[place], DRIFT_SHARE * MOST_TURNED
    )
    return differences


def _contact_points(contacts: HandContacts) -> Float[np.ndarray, "link 3"]:
    """The mean contact point of each link that touches, links ascending [m]."""
    return np.stack([contacts.points[contacts.link == link].mean(axis=0) for link in np.unique(contacts.link)])


def _numbers(what: str, stored: Any, found: Float[np.ndarray, "*shape"] | float, tolerance: float) -> list[str]:
    """The worst difference of a column's numbers, if any; nothing stored (None) equals nothing found (NaN)."""
    ours, theirs = np.asarray(found, dtype=np.float64), np.asarray(stored, dtype=np.float64)
    error = np.where(np.isnan(theirs) & np.isnan(ours), 0.0, np.abs(theirs - ours))
    if (error <= tolerance).all():
        return []
    worst = np.unravel_index(np.argmax(error), error.shape)  # a NaN is the worst
    place = "".join(f"[{index}]" for index in worst)
    return [f"{what}{place} is {theirs[worst]:.5f} in the file, {ours[worst]:.5f} found"]
