"""Where the hand touches the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

HAND_CONTACT_DISTANCE = 2e-3
"""A hand point this close to the object is in contact [m]: what fingertips yield, and what a position controller
closes."""
POINTS_PER_LINK = 4
"""Contact points that stand for one link's patch: enough to carry torque about the normal."""
DISTINCT_DISTANCE = 1e-6
"""Contact points closer than this are one point [m]."""


@dataclass(frozen=True, kw_only=True)
class HandContacts:
    """Contacts of one configuration of the hand with the object.

    Attributes:
        points: closest points on the object [m, world].
        normals: outward from the object, unit, world.
        link: index of the hand link that makes each contact, ascending.
    """

    points: Float[np.ndarray, "contact 3"]
    normals: Float[np.ndarray, "contact 3"]
    link: Int[np.ndarray, "contact"]


def moved_contacts(contacts: HandContacts, T: Float[np.ndarray, "4 4"]) -> HandContacts:
    """Return the contacts of a hand and an object that are moved together by the rigid transform T (world)."""
    points = contacts.points @ T[:3, :3].T + T[:3, 3]
    return HandContacts(points=points, normals=contacts.normals @ T[:3, :3].T, link=contacts.link)


def hand_contacts(
    normals: Float[np.ndarray, "point 3"],
    link: Int[np.ndarray, "point"],
    *,
    distance: Float[np.ndarray, "point"],
    closest: Float[np.ndarray, "point 3"],
    object_normals: Float[np.ndarray, "point 3"],
) -> HandContacts:
    """Return the contacts of one configuration, from its dense surface points near the object.

    normals: the hand's outward normals. link: the points' link indices. distance [m, negative inside], closest
    [m, world] and object_normals: exact signed distance to the object, closest point on it, and outward normal of its
    nearest triangle. Points farther than 2 mm may be left out.

    A point is a candidate if distance <= 2 mm and the two surfaces face each other (normal . object normal < 0). Of
    each link's candidates up to 4 are kept: the closest one first, then the one whose closest point is farthest from
    those already chosen, so that they spread over the patch.
    """
    facing = np.einsum("px,px->p", normals, object_normals) < 0
    candidates = np.flatnonzero((distance <= HAND_CONTACT_DISTANCE) & facing)
    chosen: list[int] = []
    for index in np.unique(link[candidates]):
        mine = candidates[link[candidates] == index]
        chosen.extend(mine[_spread(closest[mine], distance[mine])])
    return HandContacts(points=closest[chosen], normals=object_normals[chosen], link=link[chosen])


def _spread(points: Float[np.ndarray, "point 3"], distance: Float[np.ndarray, "point"]) -> list[int]:
    """Return up to 4 indices: the least distance first, then farthest-point selection."""
    chosen = [int(np.argmin(distance))]
    gap = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < POINTS_PER_LINK and gap.max() > DISTINCT_DISTANCE:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen
