"""What carries an object along the way of a push, found anew at each place of the way."""

from dataclasses import replace

import numpy as np

from dexnudge.made_once import made_once
from dexnudge.mechanics.contacts import SupportContacts, support_contacts
from dexnudge.planning.lying_object import lying_object
from dexnudge.scenes.scene import Scene

STRIDE = 0.01  # [m] at most between two places


def supports_of_way(scene: Scene, length: float) -> list[SupportContacts]:
    """Supports at places evenly spread over a way of `length` [m], both ends included, at most a centimetre apart."""
    return [supports_along(scene, way) for way in np.linspace(0.0, length, 1 + int(np.ceil(length / STRIDE)))]


def supports_along(scene: Scene, way: float) -> SupportContacts:
    """Supports of the object once it has been carried `way` [m] along the motion; found once a place.

    Where it would tip there, it is looked at as it comes to rest (see `LyingObject.at_rest`). They are given as the object
    sees them: less the way, so that they go with the contacts and the centre of mass of the scene as it is.
    """
    if way == 0:
        return support_contacts(scene)
    known = _known(scene)
    if way not in known:
        T_world_object = np.array(scene.T_world_object)
        T_world_object[:3, 3] += way * scene.motion
        T_world_object = lying_object(scene).at_rest(way * scene.motion, least=0.0).T_rocked @ T_world_object
        found = support_contacts(replace(scene, T_world_object=T_world_object))
        known[way] = replace(found, points=found.points - way * scene.motion)
    return known[way]


@made_once
def _known(_: Scene) -> dict[float, SupportContacts]:
    """By the way [m]; empty at first."""
    return {}
