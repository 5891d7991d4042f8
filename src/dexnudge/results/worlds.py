"""Whether configurations still hold where frictions, mass or place of the object are not what they are said to be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import carrying_normal, touching_contacts
from dexnudge.scenes.uncertainty import Uncertainty
from dexnudge.verification.measurements import contact_margins
from dexnudge.verification.verdicts import Verdicts, verify_in

MEASURED = Uncertainty(pose_mm=2.0, pose_deg=1.0, height_mm=0.3)
"""By which the pose of an object in measured surroundings is off: from depth images or a matched scan, and their planes."""
TRIED_DRAWS = 32  # of the best verified draws, where the object is displaced: who asks for one needs no more
STEEP = 0.1  # length of the motion's part along the support under which it has no direction on it


def uncertainty_of(scene: Scene) -> Uncertainty | None:
    """Return what is uncertain about a scene: what is said to be, else the pose where the surroundings were measured."""
    return scene.uncertainty or (MEASURED if scene.surface_noise > 0 else None)


def sampled_worlds(scene: Scene, uncertainty: Uncertainty) -> list[Scene]:
    """Return the scene with frictions, mass and pose as they may be.

    Places are left out in which something would stand in the way of the motion: the object cannot lie there.
    """
    axes, centre = _support_axes(scene), sliding_task(scene).centre
    found = []
    for physics, displacement, turn in uncertainty.sampled(scene):
        world = replace(scene, **physics)
        if uncertainty.displaces:
            moved = np.eye(4)
            moved[:3, :3] = Rotation.from_rotvec(turn * axes[2]).as_matrix()
            moved[:3, 3] = centre - moved[:3, :3] @ centre + displacement @ axes
            world = replace(world, T_world_object=moved @ scene.T_world_object)
            if not free_way(world).whole:
                continue
        found.append(world)
    return found


def balanced_in(
    scene: Scene, verdicts: Verdicts, worlds: Sequence[Mapping[str, Any]]
) -> Bool[np.ndarray, "world configuration"]:
    """Return which configurations are verified where numbers of the scene are others, such as its mass.

    Penetrations, limits, contacts and supports do not depend on them, so only the force balance is solved again; criteria of
    one's own are taken not to.
    """
    rows = [row for row, reason in enumerate(verdicts.reasons) if reason in ("", "force_margin")]
    found = np.zeros((len(worlds), len(verdicts)), dtype=bool)
    margins = contact_margins(scene, [verdicts.contacts[row] for row in rows], worlds=worlds)
    found[:, rows] = [each.balanced[:, 0] for each in margins]  # at the friction itself: the margin is 1 or more then
    return found


def share_of_worlds(
    scene: Scene, hand: Hand, q: Float[np.ndarray, "n coordinates"], verdicts: Verdicts, order: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the share of the sampled worlds in which each configuration is verified, too; 1 where all is certain.

    NaN for one that is not verified in the scene itself, or, where the object may lie elsewhere, not among the first 32
    verified in `order`, those that hold in most worlds without the displacement before others.
    """
    uncertainty = uncertainty_of(scene) or Uncertainty(worlds=1)
    share = np.full(len(q), np.nan)
    verified = order[verdicts.success[order]]
    held = np.ones(len(verified))
    if uncertainty.disturbs:
        physics = [numbers for numbers, *_ in uncertainty.sampled(scene)]
        held = balanced_in(scene, verdicts.take(verified), physics).mean(axis=0)
    if not uncertainty.displaces:
        share[verified] = held
        return share
    tried = verified[np.argsort(-held, kind="stable")][:TRIED_DRAWS]
    found = verify_in(sampled_worlds(scene, uncertainty), hand, q[tried], verdicts.criteria or None)
    share[tried] = np.sum([each.success / len(found) for each in found], axis=0)
    return share


def what_to_do(scene: Scene, share: float) -> str:
    """Return one sentence about the best configuration's share of worlds, and how to raise it."""
    uncertainty = uncertainty_of(scene)
    if uncertainty is None:
        return ""
    said = f"the best is verified in {share:.0%} of {uncertainty.worlds} sampled worlds, too"
    hand, environment = (uncertainty.hardest(scene)[name] for name in ("friction_hand", "friction_environment"))
    if share == 1.0:
        return said
    if hand <= environment:
        said += (
            f"; in the hardest the hand's friction is {hand:.2g} and the surroundings' {environment:.2g}: no press moves "
            "the object there, only pushes and hooks do"
        )
    return f"{said}; draw more (`num`), or narrow what is `uncertain`"


def _support_axes(scene: Scene) -> Float[np.ndarray, "3 3"]:
    """Return the motion along the support, the direction across it, and the support's normal; rows, unit."""
    normal = carrying_normal(touching_contacts(scene))
    normal = normal if normal.any() else np.array([0.0, 0.0, 1.0])
    along = scene.motion - (scene.motion @ normal) * normal
    if np.linalg.norm(along) < STEEP:
        along = np.eye(3)[np.abs(normal).argmin()]
        along = along - (along @ normal) * normal
    along = along / np.linalg.norm(along)
    return np.stack([along, np.cross(normal, along), normal])
