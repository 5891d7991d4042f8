"""How far the object can go along its motion before something stands in its way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import (
    MOTION_TOLERANCE,
    UPWARD,
    SupportContacts,
    carrying_normal,
    support_contacts,
    touching_contacts,
)
from dexnudge.scenes.sweep import sweep_of

WAY_TOLERANCE = 1e-3  # [m] of the motion that may lack: what a scene's object may be inside its surroundings


@dataclass(frozen=True)
class FreeWay:
    """The part of a scene's motion that is free.

    Attributes:
        length: of it [m], at most `scene.motion_length`. place: where something ends it [m, world]; None where nothing does.
        height: how far that thing reaches above what carries the object, at that place [m]; 0 without.
        touching: whether the object touches it from the beginning, and the motion runs into it.
        whole: whether all of the motion is free, to 1 mm.
    """

    length: float
    place: Float[np.ndarray, "3"] | None = None
    height: float = 0.0
    touching: bool = False
    whole: bool = True

    def __str__(self) -> str:
        if self.whole or self.place is None:
            return f"free for {1e3 * self.length:.0f} mm"
        where = f"({', '.join(f'{each:.3f}' for each in self.place.round(3) + 0.0)}) m"
        if self.touching:
            return f"blocked by what it touches at {where}, against which it would move"
        return f"blocked after {1e3 * self.length:.0f} mm by something {1e3 * self.height:.0f} mm high at {where}"


@cached_per_instance
def free_way(scene: Scene) -> FreeWay:
    """Return how far the object can be carried along `scene.motion`, and what stands in its way; found once per scene.

    The object is lifted by 1.5 mm, or twice the noise of the surfaces, along the normal of what carries it (see
    `Sweep.first_obstacle`): steps and bumps that are lower are no obstacle, and neither is the drop beyond an edge. Nor is
    what it touches from above or beside, along the motion. A support against which the motion leans ends the way at once.
    """
    touching = touching_contacts(scene)
    normal = carrying_normal(touching)
    supports = support_contacts(scene)
    along = supports.normals @ scene.motion
    if along.min(initial=0.0) < -MOTION_TOLERANCE:
        place = supports.points[along.argmin()]
        return FreeWay(0.0, place, _height(scene, place, touching, normal), touching=True, whole=False)
    found = sweep_of(scene).first_obstacle(
        scene.motion, carrying=normal, touching=touching.normals, reach=scene.motion_length
    )
    if found is None:
        return FreeWay(scene.motion_length)
    height = _height(scene, found.place, touching, normal)
    return FreeWay(found.way, found.place, height, whole=found.way >= scene.motion_length - WAY_TOLERANCE)


def _height(
    scene: Scene, place: Float[np.ndarray, "3"], touching: SupportContacts, normal: Float[np.ndarray, "3"]
) -> float:
    """Return how far what stands at a place reaches above the support [m], or above the object's lowest point."""
    up = normal if normal.any() else np.array([0.0, 0.0, 1.0])
    carrying = touching.points[touching.normals @ up > UPWARD]
    lowest = carrying if len(carrying) else sweep_of(scene).points
    return float(place @ up - (lowest @ up).min()) + sweep_of(scene).height(place, up)
