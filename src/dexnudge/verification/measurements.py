"""What several criteria need of the same hands, computed once: penetrations, contacts, force margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.hands.batch import HandBatch
from dexnudge.mechanics.contacts import HAND_CONTACT_DISTANCE, ContactBatch, HandContacts, contacts_of_hands
from dexnudge.mechanics.fast_balance import Margins, force_margins
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.free_way import FreeWay, free_way
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts
from dexnudge.verification.penetration import PenetrationCheck, Penetrations


class Measurements:
    """Measurements of hands with valid poses in a scene; each is made when it is first asked for."""

    def __init__(self, hands: HandBatch, scene: Scene) -> None:
        self._hands, self._scene = hands, scene

    @cached_property
    def penetrations(self) -> Penetrations:
        """Depths in object, surroundings and itself [m]."""
        check = PenetrationCheck(self._hands.hand, self._scene, device=self._device)
        found = check(self._T_world_link, reach=HAND_CONTACT_DISTANCE, known=self._hands.derived)
        for depths in (found.object, found.environment, found.self_collision):
            depths.flags.writeable = False  # all criteria see them
        return found

    @cached_property
    def contacts(self) -> list[HandContacts]:
        """Contacts of each hand with the object."""
        T_world_link, points = self._T_world_link, self._hands.hand.dense_points
        hits, T_world_object = self.penetrations.near_object, self._scene.T_world_object
        rotation, origin = T_world_object[:3, :3], T_world_object[:3, 3]
        link = points.link[hits.point].astype(np.int64)
        normals = np.einsum("nij,nj->ni", T_world_link[hits.configuration, link, :3, :3], points.normals[hits.point])
        closest, object_normals = hits.closest @ rotation.T + origin, hits.normal @ rotation.T
        return contacts_of_hands(
            hits.configuration,
            normals,
            link,
            num_hands=len(self._hands),
            distance=hits.distance,
            closest=closest,
            object_normals=object_normals,
        )

    @cached_property
    def contact_links(self) -> list[list[str]]:
        """Names of the links of each hand that touch the object."""
        names = self._hands.hand.link_names
        return [[names[link] for link in sorted(set(each.link.tolist()))] for each in self.contacts]

    @cached_property
    def free_way(self) -> FreeWay:
        """The part of the motion that is free."""
        return free_way(self._scene)

    @cached_property
    def margins(self) -> Margins:
        """Force margins of the contacts: the least of those where the object begins to turn and where it begins to slide."""
        return contact_margins(self._scene, self.contacts, device=self._device)[0]

    @property
    def _device(self) -> str:
        return str(self._hands.q.device)

    @cached_property
    def _T_world_link(self) -> Float[np.ndarray, "n link 4 4"]:
        return self._hands.T_world_link.detach().cpu().numpy()


def contact_margins(
    scene: Scene,
    contacts: Sequence[HandContacts],
    *,
    worlds: Sequence[Mapping[str, Any]] = ({},),
    device: str = "cpu",
) -> list[Margins]:
    """Return the force margins of contacts in each world: the least where the object begins to turn and to slide.

    worlds: numbers in place of the scene's own, by their names in `SlidingTask`.
    """
    motion, stages, batch = scene.object_motion, [], ContactBatch.of(contacts)
    for way in motion.beginnings:
        there = scene.carried(way) if way else scene
        T, supports, task = motion.displacement(way), support_contacts(there), sliding_task(there)
        moved = batch.moved(T) if way else batch
        stages.append([force_margins(moved, supports, replace(task, **world), device=device) for world in worlds])
    return [
        Margins(np.min([each.factor for each in world], axis=0), np.all([each.balanced for each in world], axis=0))
        for world in zip(*stages, strict=True)
    ]


def measure(hands: HandBatch, scene: Scene) -> Measurements:
    """Return the measurements of hands with valid poses in a scene, shared by all that ask for them.

    A criterion of one's own that asks for contacts or penetrations gets those that the built-in ones have used.
    """
    known = hands.derived
    if (Measurements, id(scene)) not in known:
        known[Measurements, id(scene)] = Measurements(hands, scene)  # it keeps the scene, so that no other has its id
    return known[Measurements, id(scene)]
