"""What tells apart configurations that all succeed where a push begins: their force margins along the way.

As an object comes over an edge, less and less of it is carried, and a finger that presses beyond the edge tips it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from dexnudge.jobs.cached import cached_per_instance
from dexnudge.mechanics.contacts import ContactBatch, HandContacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.friction_cone import across, helping, pressing
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.object_path import leans, pulled, push_length, station
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import SupportContacts

STATIONS = 3  # places along the way beside its beginning; the last one is its end
CAREFUL = (0.75, 0.5)  # of the hand's friction, with which a hand that turns an object should do
SPREAD = 0.2  # of a link's contacts that is counted on there
UPRIGHT = np.eye(4)  # a world that does not lean
SAME_PLACE = 1e-5  # [m] by which two places of supports differ for no other reason than rounding


def path_margins(
    scene: Scene, contacts: Sequence[HandContacts], *, length: float
) -> Float[np.ndarray, "configuration place"]:
    """The force margin of each configuration's contacts where the way begins and at 3 more places, evenly to its end.

    Hand and object are carried `length` [m] along the motion, keeping their contacts; what the surroundings carry is found
    anew at each place. A way of no length has one place.
    """
    batch = ContactBatch.of(contacts)
    return np.stack([_margins_at(batch, scene, way) for way in _ways(length)], axis=1)


def _ways(length: float) -> list[float]:
    return np.linspace(0.0, length, STATIONS + 1).tolist() if length > 0 else [0.0]


def find_stations(scene: Scene) -> None:
    """Find once what ranking needs of a scene whatever is drawn: how far the push goes, and what carries the object."""
    motion = scene.object_motion
    for way in {*_ways(push_length(scene)), *motion.beginnings, motion.length}:
        station(scene, way)


@cached_per_instance
def _margins_at(
    batch: ContactBatch, scene: Scene, way: float, *, grip: float = 1.0, world: int = 0
) -> Float[np.ndarray, " configuration"]:
    """Force margins where the object has been carried by `way` [m], with the share `grip` of the hand's friction.

    world: 0 stands upright; from 1 on, that of the scene's `leans`.
    """
    task = sliding_task(scene)
    task = replace(task, friction_hand=grip * task.friction_hand)
    here = station(scene, way).moved([UPRIGHT, *leans(scene)][world])
    return force_margins(batch.moved(here.T), here.supports, here.task(task)).factor[:, 0]


@cached_per_instance
def pressing_contacts(batch: ContactBatch, scene: Scene) -> ContactBatch:
    """Return those contacts that are `pressing` where the motion begins."""
    return batch.some(pressing(batch.every, scene.object_motion.twist()))


def pressing_margins(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """The least force margin on the way (see `push_length`) of those contacts alone that are `pressing`.

    Where the whole motion leaves the object carried as it is, the beginning stands for all of the way.
    """
    if not len(contacts):
        return np.zeros(0)
    length = 0.0 if _carried_alike(scene) else push_length(scene)
    return path_margins(scene, pressing_contacts(ContactBatch.of(contacts), scene), length=length).min(axis=1)


def careful_margins(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """The margin of a hand that nothing goes quite right for: the mean of those at 75 and 50 % of the hand's friction.

    Each is the least where the turn and the slide begin, and at the end, of contacts drawn together on each link, with the
    mean of its normals: a hand that needs one point at a rounded edge to push another way than its neighbours, or a whole
    fingertip to hold a moment, does not hold in physics. Of an object that is `pulled` only contacts `across` its way
    count, and it is the mean over worlds that stand upright and that lean to either side (`leans`).
    """
    batch, motion = ContactBatch.of(contacts), scene.object_motion
    if pulled(scene):
        batch = batch.some(across(batch.every, scene.motion))
    blunt = ContactBatch.of([_blunted(each) for each in batch])
    ways = [*motion.beginnings, motion.length]
    found = [
        np.min([_margins_at(blunt, scene, way, grip=share, world=world) for way in ways], axis=0)
        for world in range(1 + len(leans(scene)))
        for share in CAREFUL
    ]
    return np.mean(found, axis=0)


def _blunted(contacts: HandContacts) -> HandContacts:
    mine = contacts.link == contacts.link[:, None]
    middle = mine @ contacts.points / np.maximum(mine.sum(axis=1), 1)[:, None]
    normals = mine @ contacts.normals
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return replace(contacts, points=middle + SPREAD * (contacts.points - middle), normals=normals)


def mean_help(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """How far the contacts of each configuration press or push: the mean of `helping`, -1 without any."""
    batch = ContactBatch.of(contacts)
    return batch.mean(helping(batch.every, scene.object_motion.twist()), empty=-1.0)


def forward_offset(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """Return how far in front of the centre of mass the contacts are on average [m]; 0 behind it, infinite without any.

    As the object comes over an edge, what presses near its centre keeps it on what carries it.
    """
    batch = ContactBatch.of(contacts)
    ahead = (batch.every.points - sliding_task(scene).centre) @ scene.motion
    return np.maximum(0.0, batch.mean(ahead, empty=np.inf))


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
