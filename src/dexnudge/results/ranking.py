"""What tells apart configurations that all succeed where a push begins: their force margins along the way.

As an object comes over an edge, less and less of it is carried, and a finger that presses beyond the edge tips it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts, moved_contacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.friction_cone import helping, pressing, some_contacts
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.object_path import push_length, station
from dexnudge.results.worlds import share_of_worlds, uncertainty_of
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import SupportContacts
from dexnudge.verification.criteria import MARGIN_AGREEMENT, ROBUST_MARGIN, SUCCESS_MARGIN
from dexnudge.verification.verdicts import Verdicts

STATIONS = 3  # places along the way beside its beginning; the last one is its end
SAME_PLACE = 1e-5  # [m] by which two places of supports differ for no other reason than rounding


def path_margins(
    scene: Scene, contacts: Sequence[HandContacts], *, length: float
) -> Float[np.ndarray, "configuration place"]:
    """The force margin of each configuration's contacts where the way begins and at 3 more places, evenly to its end.

    Hand and object are carried `length` [m] along the motion, keeping their contacts; what the surroundings carry is found
    anew at each place. A way of no length has one place.
    """
    places = np.linspace(0.0, length, STATIONS + 1) if length > 0 else np.zeros(1)
    task, margins = sliding_task(scene), []
    for here in (station(scene, float(way)) for way in places):
        there = [moved_contacts(each, here.T) for each in contacts]
        margins.append(force_margins(there, here.supports, here.task(task)).factor[:, 0])
    return np.stack(margins, axis=1)


def pressing_margins(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """The least force margin on the way (see `push_length`) of those contacts alone that are `pressing`.

    Where the whole motion leaves the object carried as it is, the beginning stands for all of the way.
    """
    if not len(contacts):
        return np.zeros(0)
    length = 0.0 if _carried_alike(scene) else push_length(scene)
    alone = [some_contacts(each, pressing(each, scene.object_motion.twist())) for each in contacts]
    return path_margins(scene, alone, length=length).min(axis=1)


def mean_help(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """How far the contacts of each configuration press or push: the mean of `helping`, -1 without any."""
    return np.array(
        [helping(each, scene.object_motion.twist()).mean() if len(each.points) else -1.0 for each in contacts]
    )


def forward_offset(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """Return how far in front of the centre of mass the contacts are on average [m]; 0 behind it, infinite without any.

    As the object comes over an edge, what presses near its centre keeps it on what carries it.
    """
    centre = sliding_task(scene).centre
    ahead = [(each.points - centre) @ scene.motion for each in contacts]
    return np.array([max(0.0, each.mean()) if len(each) else np.inf for each in ahead])


@dataclass(frozen=True)
class Ranking:
    """What draws are ranked by.

    Attributes:
        keys: most important first; less is better.
        agreement: what rounding may change in each of them.
        foresight: what files show, see `Samples.foresight`.
        tolerance: what rounding may change in each of that.
    """

    keys: Float[np.ndarray, "key draw"]
    agreement: Float[np.ndarray, " key"]
    foresight: dict[str, Float[np.ndarray, " draw"]]
    tolerance: dict[str, float]

    @property
    def order(self) -> Int[np.ndarray, " draw"]:
        """The draws, best first."""
        return np.lexsort(self.keys[::-1])

    def out_of_order(self) -> Int[np.ndarray, " place"]:
        """Return the places of those draws that are better than the one in front of them, beyond what rounding explains."""
        keys = np.nan_to_num(self.keys, nan=np.inf, posinf=np.finfo(np.float64).max)
        difference = np.diff(keys, axis=1)
        deciding = (difference != 0.0).argmax(axis=0)  # the first key in which two neighbours differ, if any
        step = np.take_along_axis(difference, deciding[None], axis=0)[0]
        return np.flatnonzero(step < -self.agreement[deciding]) + 1


def ranking(scene: Scene, verdicts: Verdicts, hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> Ranking:
    """Return how draws rank: verified ones first; among them those that push best.

    That is: where something is uncertain, by the share of the worlds in which they hold (`share_of_worlds`); by the margin
    where the path begins, up to 1.5 (robust); by the least one on the path of those contacts alone that press or push, up to
    1; by how near to the object's centre of mass or behind it they are on average; by how far they press or push; by the
    least penetration. Larger margins are those of hands that squeeze, and slip.
    """
    keys = _keys(scene, verdicts)
    foresight, tolerance = {}, {}
    agreement = [0.0, MARGIN_AGREEMENT, MARGIN_AGREEMENT, 1e-6, 1e-6, 1e-6]
    if (uncertainty := uncertainty_of(scene)) is not None:
        share = share_of_worlds(scene, hand, q, verdicts, np.lexsort(keys[::-1]))
        foresight["share_of_worlds"], tolerance["share_of_worlds"] = share, 1.01 / uncertainty.worlds
        keys = np.insert(keys, 1, -np.nan_to_num(share), axis=0)
        agreement.insert(1, 1.01 / uncertainty.worlds)
    return Ranking(keys, np.array(agreement), foresight, tolerance)


def _keys(scene: Scene, verdicts: Verdicts) -> Float[np.ndarray, "key draw"]:
    """Return what draws are ranked by where all is certain."""
    margin, verified = np.asarray(verdicts.force_margin), np.flatnonzero(verdicts.success)
    pressing, ahead, helping = np.zeros((3, len(margin)))
    if len(verified) > 1:
        contacts = [verdicts.contacts[row] for row in verified]
        pressing[verified] = pressing_margins(scene, contacts)
        ahead[verified], helping[verified] = forward_offset(scene, contacts), mean_help(scene, contacts)
    deepest = verdicts.deepest_penetration
    margins = -np.minimum(margin, ROBUST_MARGIN), -np.minimum(pressing, SUCCESS_MARGIN)
    return np.stack([~verdicts.success, *margins, ahead, -helping, deepest]).astype(np.float64)


def _carried_alike(scene: Scene) -> bool:
    """Whether the surroundings carry the object at the end of the motion where they do at its beginning."""
    if scene.turn is not None:
        return False
    before, after = (station(scene, way).supports for way in (0.0, scene.motion_length))
    if len(before.points) != len(after.points):
        return False
    return bool(np.abs(_sorted(after) - _sorted(before)).max(initial=0.0) < SAME_PLACE)


def _sorted(supports: SupportContacts) -> Float[np.ndarray, "support 6"]:
    """Places and normals, in an order that depends on nothing but them."""
    rows = np.concatenate([supports.points, supports.normals], axis=1)
    return rows[np.lexsort(np.round(rows / SAME_PLACE).T)]
