"""Whether configurations still hold where the object does not lie quite where it was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import carrying_normal, touching_contacts
from dexnudge.verification.verdicts import Verdicts, verify

DISPLACEMENT = 0.002  # [m] along its support by which a pose from depth images or a matched scan is off
HEIGHT = 0.0003  # [m] by which what it was settled on is off, by its fitted plane or the tilt that is left
TURN = np.radians(1.0)  # [rad] the same about the vertical
WORLDS = 8  # directions of the displacement, evenly spread from the motion on
TRIED_DRAWS = 24  # of the best verified draws that are tried in them: who asks for one needs no more
STEEP = 0.1  # length of the motion's part along the support under which it has no direction on it


def displaced_scenes(scene: Scene) -> list[Scene]:
    """Return the scene with its object 2 mm off along its support, in 8 directions.

    Every other time it is turned by 1 degree to one side about its centre, else to the other; two by two it is raised or
    lowered by 0.3 mm, so that what is just within a limit does not pass for certain. Places are left out in which something
    would stand in the way of the motion: the object cannot lie there.
    """
    normal = carrying_normal(touching_contacts(scene))
    normal = normal if normal.any() else np.array([0.0, 0.0, 1.0])
    along = scene.motion - (scene.motion @ normal) * normal
    if np.linalg.norm(along) < STEEP:
        along = np.eye(3)[np.abs(normal).argmin()]
        along = along - (along @ normal) * normal
    along = along / np.linalg.norm(along)
    across, centre = np.cross(normal, along), sliding_task(scene).centre
    found = []
    for place in range(WORLDS):
        angle = 2 * np.pi * place / WORLDS
        moved = np.eye(4)
        moved[:3, :3] = Rotation.from_rotvec(TURN * (-1) ** place * normal).as_matrix()
        moved[:3, 3] = centre - moved[:3, :3] @ centre
        moved[:3, 3] += DISPLACEMENT * (np.cos(angle) * along + np.sin(angle) * across)
        moved[:3, 3] += HEIGHT * (-1) ** (place // 2) * normal
        displaced = replace(scene, T_world_object=moved @ scene.T_world_object)
        if free_way(displaced).whole:
            found.append(displaced)
    return found


def share_held(
    scene: Scene, hand: Hand, q: Float[np.ndarray, "n coordinates"], verdicts: Verdicts, order: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the share of the displaced scenes in which each configuration is verified, too.

    Only where the surroundings were measured (`scene.surface_noise` above 0): elsewhere the object lies where it is said to
    lie, and all shares are 0. So are those of draws that are not verified, or not among the first 24 verified in `order`.
    """
    held = np.zeros(len(q))
    rows = order[verdicts.success[order]][:TRIED_DRAWS]
    if scene.surface_noise == 0 or len(rows) < 2:
        return held
    worlds = displaced_scenes(scene)
    for world in worlds:
        held[rows] += verify(world, hand, q[rows], verdicts.criteria or None).success
    return held / max(1, len(worlds))
