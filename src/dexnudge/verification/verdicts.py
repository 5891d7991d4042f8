"""The verdict on a hand configuration: penetration, joint limits, and forces that move the object."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from dexnudge.errors import InputError
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.balance import MOTION_TOLERANCE
from dexnudge.mechanics.contacts import HAND_CONTACT_DISTANCE, HandContacts, hand_contacts, support_contacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.scene import Scene
from dexnudge.verification.penetration import PenetrationCheck, Penetrations

PENETRATION_LIMIT = 1e-3
"""Greatest depth of a successful configuration [m]."""
SUCCESS_MARGIN = 1.0
ROBUST_MARGIN = 1.5
"""Force margins from which a configuration succeeds, and is robust [-]."""
LIMITS_TOLERANCE = 1e-4
"""Violation of limits and couplings that single precision explains [rad]."""
ROTATION_TOLERANCE = 1e-4
"""Deviation of the 6D rotation's columns from unit length and right angle that single precision explains [-]."""


@dataclass(frozen=True)
class Verdicts:
    """What was found about each of n configurations.

    success: all conditions hold. robust: and the force margin is at least 1.5.
    penetration_object, penetration_environment, penetration_self: greatest depth [m], 0 if none.
    force_margin: largest factor in [0, 3] on friction_environment at which forces balance (see mechanics.balance).
    limits_violation: greatest violation of a joint limit or coupling [rad].
    contacts: with the object, one for each configuration; none for one that is not valid.
    contact_links: names of the links in contact with the object. reasons: the first condition that fails, of
    "invalid", "joint limits", "penetration environment", "penetration object", "penetration self", "no contact",
    "motion blocked", "force"; "" for a success.

    A configuration that is "invalid" (not finite, or no rotation) has no pose: its depths and violation are NaN, its
    margin 0.
    """

    success: Bool[np.ndarray, " n"]
    robust: Bool[np.ndarray, " n"]
    penetration_object: Float[np.ndarray, " n"]
    penetration_environment: Float[np.ndarray, " n"]
    penetration_self: Float[np.ndarray, " n"]
    force_margin: Float[np.ndarray, " n"]
    limits_violation: Float[np.ndarray, " n"]
    contacts: list[HandContacts]
    contact_links: list[list[str]]
    reasons: list[str]

    def take(self, rows: Int[np.ndarray, " m"] | Bool[np.ndarray, " n"]) -> Verdicts:
        """Return the verdicts at the given places, in that order."""
        places = np.arange(len(self.success))[rows]
        picked: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            picked[field.name] = value[places] if isinstance(value, np.ndarray) else [value[i] for i in places]
        return Verdicts(**picked)

    @classmethod
    def concatenate(cls, parts: Sequence[Verdicts]) -> Verdicts:
        """Return the verdicts of several batches as those of one."""
        joined: dict[str, Any] = {}
        for field in dataclasses.fields(cls):
            values = [getattr(part, field.name) for part in parts]
            arrays = isinstance(values[0], np.ndarray)
            joined[field.name] = np.concatenate(values) if arrays else list(itertools.chain.from_iterable(values))
        return cls(**joined)


def verify(scene: Scene, hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> Verdicts:
    """Return the verdicts on configurations q (n, 9 + d) of the hand in the world.

    Success: valid, penetrations <= 1 mm, joints within limits and couplings, force margin >= 1, and the forces balance
    at the friction itself. The last two differ only where feasibility is not monotone in the friction, as for a hand
    that merely holds back an object on a ramp.

    Raises:
        InputError: q is not of shape (n, 9 + d).
    """
    q = _checked(hand, q)
    valid = _valid(q)
    measured = {name: np.full(len(q), np.nan) for name in ("object", "environment", "itself", "limits")}
    margin, balanced = np.zeros(len(q)), np.zeros(len(q), dtype=bool)
    penetrations, touching = _touch(hand, scene, q[valid])
    for name in ("object", "environment", "itself"):
        measured[name][valid] = getattr(penetrations, name)
    measured["limits"][valid] = limits_violation(hand, q[valid])
    supports, task = support_contacts(scene), sliding_task(scene)
    margins = force_margins(touching, supports, task)
    margin[valid], balanced[valid] = margins.factor[:, 0], margins.balanced[:, 0]
    contacts = _of_all(touching, valid)
    links = [[hand.link_names[link] for link in np.unique(each.link)] for each in contacts]
    failures = {
        "invalid": ~valid,
        "joint limits": ~(measured["limits"] <= LIMITS_TOLERANCE),
        "penetration environment": ~(measured["environment"] <= PENETRATION_LIMIT),
        "penetration object": ~(measured["object"] <= PENETRATION_LIMIT),
        "penetration self": ~(measured["itself"] <= PENETRATION_LIMIT),
        "no contact": np.array([not names for names in links], dtype=bool),
        "motion blocked": np.full(len(q), bool(np.any(supports.normals @ task.motion < -MOTION_TOLERANCE))),
        "force": ~((margin >= SUCCESS_MARGIN) & balanced),
    }
    reasons = [next((name for name, failed in failures.items() if failed[row]), "") for row in range(len(q))]
    success = np.array([not name for name in reasons], dtype=bool)
    return Verdicts(
        success=success,
        robust=success & (margin >= ROBUST_MARGIN),
        penetration_object=measured["object"],
        penetration_environment=measured["environment"],
        penetration_self=measured["itself"],
        force_margin=margin,
        limits_violation=measured["limits"],
        contacts=contacts,
        contact_links=links,
        reasons=reasons,
    )


def contacts_of(scene: Scene, hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> list[HandContacts]:
    """Return each configuration's contacts with the object; none for one that is not valid.

    Raises:
        InputError: q is not of shape (n, 9 + d).
    """
    q = _checked(hand, q)
    valid = _valid(q)
    return _of_all(_touch(hand, scene, q[valid])[1], valid)


def contact_points(scene: Scene, hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> list[Float[np.ndarray, "_ 3"]]:
    """Return the points where each configuration touches the object [m, world]."""
    return [each.points for each in contacts_of(scene, hand, q)]


def limits_violation(hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> Float[np.ndarray, " n"]:
    """Return the greatest amount by which a joint is beyond a limit, or a follower beyond its leader [rad]; 0 if none."""
    angles = q[:, ROOT_COORDINATES:]
    coupled = hand.coupled_indices
    excess = np.concatenate(
        [hand.lower - angles, angles - hand.upper, angles[:, coupled[:, 0]] - angles[:, coupled[:, 1]]], axis=1
    )
    return np.maximum(excess, 0.0).max(axis=1, initial=0.0)


def _checked(hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> Float[np.ndarray, "n coordinates"]:
    q = np.asarray(q, dtype=np.float64)
    coordinates = ROOT_COORDINATES + len(hand.joint_names)
    if q.ndim != 2 or q.shape[1] != coordinates:
        raise InputError(
            f"q has shape {q.shape}; hand '{hand.name}' expects (n, {coordinates}): translation (3), 6D rotation (6), "
            f"{len(hand.joint_names)} joint angles"
        )
    return q


def _valid(q: Float[np.ndarray, "n coordinates"]) -> Bool[np.ndarray, " n"]:
    """Return which rows are finite and hold the first two columns of a rotation."""
    finite = np.isfinite(q).all(axis=1)
    first, second = np.where(finite[:, None], q, 0.0)[:, 3:ROOT_COORDINATES].reshape(-1, 2, 3).swapaxes(0, 1)
    products = np.stack([(first * first).sum(1) - 1.0, (second * second).sum(1) - 1.0, (first * second).sum(1)])
    return finite & (np.abs(products) <= ROTATION_TOLERANCE).all(axis=0)


def _of_all(contacts: list[HandContacts], valid: Bool[np.ndarray, " n"]) -> list[HandContacts]:
    """Return the contacts of all n configurations from those of the valid ones; none for the others."""
    nothing = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=np.int64))
    found = iter(contacts)
    return [next(found) if ok else nothing for ok in valid]


def _touch(hand: Hand, scene: Scene, q: Float[np.ndarray, "n coordinates"]) -> tuple[Penetrations, list[HandContacts]]:
    """Return the penetrations and contacts of valid configurations."""
    T_world_link = hand.forward_kinematics(torch.as_tensor(q)).detach().cpu().numpy()
    penetrations = PenetrationCheck(hand, scene)(T_world_link, reach=HAND_CONTACT_DISTANCE)
    hits, points = penetrations.near_object, hand.dense_points
    rotation, origin = scene.T_world_object[:3, :3], scene.T_world_object[:3, 3]
    link = points.link[hits.point].astype(np.int64)
    normals = np.einsum("nij,nj->ni", T_world_link[hits.configuration, link, :3, :3], points.normals[hits.point])
    closest, object_normals = hits.closest @ rotation.T + origin, hits.normal @ rotation.T
    contacts = []
    for row in range(len(q)):
        mine = np.flatnonzero(hits.configuration == row)
        contacts.append(
            hand_contacts(
                normals[mine],
                link[mine],
                distance=hits.distance[mine],
                closest=closest[mine],
                object_normals=object_normals[mine],
            )
        )
    return penetrations, contacts
