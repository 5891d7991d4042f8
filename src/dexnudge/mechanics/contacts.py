"""Where the hand touches the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import overload

import numpy as np
from jaxtyping import Bool, Float, Int

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

    def some(self, kept: slice | Bool[np.ndarray, " contact"]) -> HandContacts:
        """Return those of the contacts that are kept."""
        return HandContacts(points=self.points[kept], normals=self.normals[kept], link=self.link[kept])

    def moved(self, T: Float[np.ndarray, "4 4"]) -> HandContacts:
        """Return the contacts of a hand and an object that are moved together by the rigid transform T (world)."""
        points = self.points @ T[:3, :3].T + T[:3, 3]
        return HandContacts(points=points, normals=self.normals @ T[:3, :3].T, link=self.link)


class ContactBatch(Sequence[HandContacts]):
    """Contacts of several configurations in one array after another; an entry is those of one configuration.

    Attributes:
        every: the contacts of all. begins: where those of each configuration begin, and behind them their number.
        owner: whose each contact is.
    """

    def __init__(self, every: HandContacts, begins: Int[np.ndarray, "configuration_and_one"]) -> None:
        self.every, self.begins = every, begins
        self.owner = np.repeat(np.arange(len(begins) - 1), np.diff(begins))

    @classmethod
    def of(cls, contacts: Sequence[HandContacts]) -> ContactBatch:
        """Return contacts as a batch; a batch as it is."""
        if isinstance(contacts, ContactBatch):
            return contacts
        nothing = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=np.int64))
        parts = [nothing, *contacts]
        every = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ("points", "normals", "link")
        }
        return cls(HandContacts(**every), np.cumsum([len(part.link) for part in parts]))

    def __len__(self) -> int:
        return len(self.begins) - 1

    @overload
    def __getitem__(self, place: int) -> HandContacts: ...
    @overload
    def __getitem__(self, place: slice) -> list[HandContacts]: ...
    def __getitem__(self, place: int | slice) -> HandContacts | list[HandContacts]:
        if isinstance(place, slice):
            return [self[each] for each in range(len(self))[place]]
        place = range(len(self))[place]
        return self.every.some(slice(self.begins[place], self.begins[place + 1]))

    def moved(self, T: Float[np.ndarray, "4 4"]) -> ContactBatch:
        """Return the contacts of hands and objects that are moved together by the rigid transform T (world)."""
        return ContactBatch(self.every.moved(T), self.begins)

    def some(self, kept: Bool[np.ndarray, " contact"]) -> ContactBatch:
        """Return those of all contacts that are kept."""
        return ContactBatch(self.every.some(kept), np.concatenate([[0], np.cumsum(kept)])[self.begins])

    def reduced(
        self, ufunc: np.ufunc, values: Float[np.ndarray, " contact"], *, empty: float
    ) -> Float[np.ndarray, " configuration"]:
        """Return what a function such as `np.add` makes of each configuration's values; `empty` without any."""
        found, some = np.full(len(self), empty), np.diff(self.begins) > 0
        if some.any():
            found[some] = ufunc.reduceat(values, self.begins[:-1][some])
        return found

    def mean(
        self, values: Float[np.ndarray, " contact"], *, empty: float = np.nan
    ) -> Float[np.ndarray, " configuration"]:
        """Return the mean of each configuration's values, rounded as theirs alone would be; `empty` without any."""
        parts = (values[begin:end] for begin, end in pairwise(self.begins.tolist()))
        return np.array([part.mean() if len(part) else empty for part in parts])

    def link_places(self) -> tuple[Int[np.ndarray, " contact"], Int[np.ndarray, " configuration"]]:
        """Return the place of each contact's link among those of its configuration, and how many links each has."""
        most = int(self.every.link.max(initial=0)) + 1
        pairs, place = np.unique(self.owner * most + self.every.link, return_inverse=True)
        count = np.bincount(pairs // most, minlength=len(self))
        return place - (np.cumsum(count) - count)[self.owner], count


def contacts_of_hands(
    hand: Int[np.ndarray, "point"],
    normals: Float[np.ndarray, "point 3"],
    link: Int[np.ndarray, "point"],
    *,
    num_hands: int,
    distance: Float[np.ndarray, "point"],
    closest: Float[np.ndarray, "point 3"],
    object_normals: Float[np.ndarray, "point 3"],
) -> list[HandContacts]:
    """Return the contacts of each of several hands, from their dense surface points near the object.

    hand, link: whose each point is, and of which of its links. normals: the hand's outward normals. distance [m, negative
    inside], closest [m, world] and object_normals: exact signed distance to the object, closest point on it, and outward
    normal of its nearest triangle. Points farther than 2 mm may be left out.

    A point is a candidate if distance <= 2 mm and the two surfaces face each other (normal . object normal < 0). Of
    each link's candidates up to 4 are kept: the closest one first, then the one whose closest point is farthest from
    those already chosen, so that they spread over the patch.
    """
    facing = np.einsum("px,px->p", normals, object_normals) < 0
    candidates = np.flatnonzero((distance <= HAND_CONTACT_DISTANCE) & facing)
    candidates = candidates[np.lexsort((link[candidates], hand[candidates]))]
    owner = np.stack([hand[candidates], link[candidates]])
    begins = np.flatnonzero(np.diff(owner, axis=1, prepend=-1).any(axis=0))
    patch = np.zeros(len(candidates), dtype=np.int64)
    patch[begins[1:]] = 1
    patch = np.cumsum(patch)
    column = np.arange(len(candidates)) - begins[patch]
    # A row for each link of each hand, its candidates in front.
    rows = np.full((len(begins), int(column.max(initial=0)) + 1), -1)
    rows[patch, column] = candidates
    chosen, row = _spread(rows, distance, closest)
    order = np.argsort(row, kind="stable")
    chosen = chosen[order]
    every = HandContacts(points=closest[chosen], normals=object_normals[chosen], link=link[chosen])
    return list(ContactBatch(every, np.searchsorted(hand[chosen], np.arange(num_hands + 1))))


def _spread(
    rows: Int[np.ndarray, "patch candidate"],
    distance: Float[np.ndarray, " point"],
    points: Float[np.ndarray, "point 3"],
) -> tuple[Int[np.ndarray, " chosen"], Int[np.ndarray, " chosen"]]:
    """Return up to 4 points of each patch and the patch of each: the least distance first, then farthest-point selection.

    rows: the points of each patch; -1 behind them.
    """
    patches, there, places = np.arange(len(rows)), rows >= 0, points[rows]
    newest = np.where(there, distance[rows], np.inf).argmin(axis=1)
    chosen, owner = [rows[patches, newest]], [patches]
    gap = np.where(there, np.inf, -np.inf)
    for _ in range(POINTS_PER_LINK - 1):
        gap = np.minimum(gap, np.linalg.norm(places - places[np.arange(len(places)), newest][:, None], axis=2))
        left = gap.max(axis=1, initial=-np.inf) > DISTINCT_DISTANCE
        patches, places, gap, rows = patches[left], places[left], gap[left], rows[left]
        newest = gap.argmax(axis=1) if len(gap) else patches
        chosen.append(rows[np.arange(len(rows)), newest])
        owner.append(patches)
    return np.concatenate(chosen), np.concatenate(owner)
