"""The friction cones of a hand's contacts, and which of them press an object down or push it from behind."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.mechanics.contacts import HandContacts
from dexnudge.scenes.motion import Twist

EDGE_COUNT = 8
"""Edges of the inner pyramid of a hand contact's friction cone."""

ALIGNMENT_LIMIT = 0.2
"""Length of the motion's tangential part below which it no longer orients a pyramid [-]: within 11.5 degrees of the
normal that part is mostly noise of the mesh's normals, and the vertical takes its place."""

UP = np.array([0.0, 0.0, 1.0])
Motions = Float[np.ndarray, "3"] | Float[np.ndarray, "contact 3"]  # unit vectors, one for all contacts or one of each


def contact_tangents(
    normals: Float[np.ndarray, "contact 3"], motion: Motions
) -> tuple[Float[np.ndarray, "contact 3"], Float[np.ndarray, "contact 3"]]:
    """Return two unit tangents per contact, the first along its motion (unit) as far as the surface allows.

    t1 = (u - (u.n) n) / |.|, t2 = n x t1. Where u is nearly normal to the surface, the vertical takes its place, and
    where that is normal too, the world's x axis. The choice turns with the scene, so a rigid motion of everything
    changes no result; and an edge of the pyramid lies along the motion, so that a press has its exact closed form.
    """
    chosen = np.zeros_like(normals)
    missing = np.ones(len(normals), dtype=bool)
    for reference in (motion, UP, np.array([1.0, 0.0, 0.0])):
        tangential = reference - normals * (normals * reference).sum(axis=1, keepdims=True)
        length = np.linalg.norm(tangential, axis=1)
        usable = missing & (length >= ALIGNMENT_LIMIT)
        chosen[usable] = tangential[usable] / length[usable, None]
        missing &= ~usable
    return chosen, np.cross(normals, chosen)


def friction_cone_edges(
    normals: Float[np.ndarray, "contact 3"], motion: Motions, *, friction: float
) -> Float[np.ndarray, "contact edge 3"]:
    """Return the edges of each contact's pyramid as forces ON the object with unit normal component.

    f_k = -n + friction * (cos(2 pi k / 8) t1 + sin(2 pi k / 8) t2), k = 0..7, with n the OUTWARD normal of the object
    (world, unit) and t1, t2 from `contact_tangents`. The edges lie on the cone: the pyramid is inside it.
    """
    first, second = contact_tangents(normals, motion)
    angle = 2.0 * np.pi * np.arange(EDGE_COUNT) / EDGE_COUNT
    tangential = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    return -normals[:, None] + friction * tangential


def wrenches(
    points: Float[np.ndarray, "*#batch 3"],
    forces: Float[np.ndarray, "*#batch 3"],
    *,
    centre: Float[np.ndarray, "3"],
    half_length: float,
) -> Float[np.ndarray, "*batch 6"]:
    """Return force then torque about `centre`, the torque divided by `half_length`: all six in units of the force."""
    torques = np.cross((points - centre) / half_length, forces)
    return np.concatenate([np.broadcast_to(forces, torques.shape), torques], axis=-1)


PRESSING = 0.7  # cosine between a contact's inward normal and the way down or forward, from which it presses or pushes
ACROSS = 0.5  # cosine of a contact's normal with the way, up to which it pinches what is pulled


def pressing(contacts: HandContacts, twist: Twist) -> Bool[np.ndarray, " contact"]:
    """Return which contacts press down, or push the object the way it moves there.

    The balance counts on contacts that squeeze an object from two sides or hold it back in front, and needs their forces to
    be just right; in physics such a contact turns the object or slips off. Nothing depends on those that press or push.
    """
    return helping(contacts, twist) > PRESSING


def across(contacts: HandContacts, direction: Float[np.ndarray, "3"]) -> Bool[np.ndarray, " contact"]:
    """Return which contacts pinch an object pulled in a direction (unit): on its sides or on top, not before or behind it.

    Between fingers before and behind it the object is squeezed, or let go, by as much as the hand lags or leads.
    """
    return np.abs(contacts.normals @ direction) < ACROSS


def helping(contacts: HandContacts, twist: Twist) -> Float[np.ndarray, " contact"]:
    """Return the greater cosine of each contact's inward normal with the way down and with the object's motion there."""
    return np.maximum(contacts.normals[:, 2], -(contacts.normals * twist.direction(contacts.points)).sum(axis=1))
