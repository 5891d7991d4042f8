"""Which contacts of a hand press an object down or push it from behind."""

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.mechanics.contacts import HandContacts

PRESSING = 0.7  # cosine between a contact's inward normal and the way down or forward, from which it presses or pushes


def pressing(contacts: HandContacts, motion: Float[np.ndarray, "3"]) -> Bool[np.ndarray, " contact"]:
    """Which contacts press down or push along `motion` (unit, world).

    The balance counts on contacts that squeeze an object from two sides or hold it back in front, and needs their forces to
    be just right; in physics such a contact turns the object or slips off. Nothing depends on those that press or push.
    """
    return helping(contacts, motion) > PRESSING


def helping(contacts: HandContacts, motion: Float[np.ndarray, "3"]) -> Float[np.ndarray, " contact"]:
    """Cosine between each contact's inward normal and the way down or along `motion` (unit, world), whichever is greater."""
    return np.maximum(contacts.normals[:, 2], -contacts.normals @ motion)


def some_contacts(contacts: HandContacts, kept: Bool[np.ndarray, " contact"]) -> HandContacts:
    """Those of the contacts that are kept."""
    return HandContacts(points=contacts.points[kept], normals=contacts.normals[kept], link=contacts.link[kept])
