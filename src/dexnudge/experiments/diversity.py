"""How different the verified configurations of one object and scene are from each other."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.scenes.scene import Scene

SEVERAL = 2  # fewer configurations, or contact places, have no spread


def joint_diversity(q: Float[np.ndarray, "n coordinates"]) -> float | None:
    """Standard deviation (n - 1) of each joint angle over the configurations, mean over the joints [rad]."""
    if len(q) < SEVERAL:
        return None
    return float(q[:, ROOT_COORDINATES:].astype(np.float64).std(axis=0, ddof=1).mean())


def contact_diversity(hand: Hand, scene: Scene, contacts: Sequence[HandContacts]) -> float | None:
    """Mean distance of the fingertips' contact places from their common mean, over half the object's length.

    A place is the mean of one fingertip's contact points in one configuration, so that a flat contact counts no more
    than a point.
    """
    places = [
        each.points[each.link == hand.link_names.index(tip)].mean(axis=0)
        for each in contacts
        for tip in hand.fingertip_links
        if (each.link == hand.link_names.index(tip)).any()
    ]
    if len(places) < SEVERAL:
        return None
    half_length = 0.5 * float(np.max(scene.object_mesh.extents))
    away = np.linalg.norm(np.array(places) - np.mean(places, axis=0), axis=1)
    return float(away.mean()) / half_length
