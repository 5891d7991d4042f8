"""Force margins along the way of a push, not only where it begins: what tells apart configurations that all succeed there.

As an object comes over an edge, less and less of it is carried, and a finger that presses beyond the edge tips it.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from dexnudge.mechanics.contacts import HandContacts, SupportContacts, support_contacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.mechanics.supports_along import supports_along
from dexnudge.planning.push_length import push_length
from dexnudge.scenes.scene import Scene

STATIONS = 3  # places along the way beside its beginning; the last one is its end
PRESSING = 0.7  # cosine from which a contact presses down or pushes from behind
NO_PRESS = 1.0  # [m] in front of the centre of mass: where a hand counts as pressing that does so nowhere
SAME_PLACE = 1e-5  # [m] by which two places of supports differ for no other reason than rounding


def way_margins(
    scene: Scene, contacts: Sequence[HandContacts], *, length: float
) -> Float[np.ndarray, "configuration station"]:
    """The force margin of each configuration's contacts at 3 places evenly spread over the way, the end included.

    Hand and object are carried `length` [m] along the motion, keeping their contacts; what the surroundings carry is found
    anew at each place.
    """
    margins = np.zeros((len(contacts), STATIONS))
    for station in range(STATIONS):
        supports = supports_along(scene, (station + 1) / STATIONS * length)
        margins[:, station] = force_margins(contacts, supports, sliding_task(scene)).factor[:, 0]
    return margins


def least_margins(
    scene: Scene, contacts: Sequence[HandContacts], force_margin: Float[np.ndarray, " configuration"]
) -> Float[np.ndarray, " configuration"]:
    """The least force margin from the beginning, where it is `force_margin`, to the end of the way (see `push_length`).

    Where the whole motion leaves the object carried as it is, no margin changes, and none is computed.
    """
    if not len(contacts) or _carried_alike(scene):
        return np.array(force_margin)
    return np.minimum(force_margin, way_margins(scene, contacts, length=push_length(scene)).min(axis=1))


def helping(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """How far the contacts of each configuration press down or push from behind: their mean cosine.

    The balance counts on contacts that squeeze an object from two sides or hold it back in front, and needs their forces to
    be just right; in physics such a contact turns the object or slips off. Nothing depends on those that press or push.
    """
    return np.array([_help(scene, each).mean() if len(each.points) else -1.0 for each in contacts])


def rearmost_press(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """How far in front of the object's centre of mass the rearmost contact is that presses down or pushes [m], in whole cm.

    0 at and behind the centre, 1 m for a hand that neither presses nor pushes. As the object comes over an edge, only what
    presses near its centre keeps it on what carries it; a hand that presses in front alone tips it, and slips off.
    """
    centre = sliding_task(scene).centre
    pressing = [each.points[_help(scene, each) > PRESSING] for each in contacts]
    places = [((points - centre) @ scene.motion).min(initial=NO_PRESS) for points in pressing]
    return np.round(np.clip(places, 0.0, None), 2)


def _help(scene: Scene, contacts: HandContacts) -> Float[np.ndarray, " contact"]:
    """Cosine between each contact's inward normal and the way down or forward, whichever is greater."""
    return np.maximum(contacts.normals[:, 2], -contacts.normals @ scene.motion)


def _carried_alike(scene: Scene) -> bool:
    """Whether the surroundings carry the object at the end of the motion where they do at its beginning."""
    before, after = support_contacts(scene), supports_along(scene, scene.motion_length)
    if len(before.points) != len(after.points):
        return False
    return bool(np.abs(_sorted(after) - _sorted(before)).max(initial=0.0) < SAME_PLACE)


def _sorted(supports: SupportContacts) -> Float[np.ndarray, "support 6"]:
    """Places and normals, in an order that depends on nothing but them."""
    rows = np.concatenate([supports.points, supports.normals], axis=1)
    return rows[np.lexsort(np.round(rows / SAME_PLACE).T)]
