"""How far the object can go along its motion before something stands in its way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.optimize import nnls

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.surface_lattice import faces_near
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import (
    MOTION_TOLERANCE,
    PIVOT_SPEED,
    UPWARD,
    SupportContacts,
    carrying_normal,
    support_contacts,
    touching_contacts,
)
from dexnudge.scenes.support_hull import hull_corners
from dexnudge.scenes.sweep import first_met, sweep_of

TIPPING = 2e-3  # [m] the centre of mass may be beyond what carries the object: the error of a measured pose
SUM_WEIGHT = 1e3  # of the condition that the weights of a convex combination sum to 1, against metres
CARRIED_STEP = 5e-3  # [m] of the way, between places where the object must be carried
MOST_PLACES = 300  # of it that are looked at there
WAY_TOLERANCE = 1e-3  # [m] of the motion that may lack: what a scene's object may be inside its surroundings


@dataclass(frozen=True)
class FreeWay:
    """The part of a scene's motion that is free.

    Attributes:
        length: of it [m], at most `scene.object_motion.length`: that of the turn, as the arc of the object's farthest point,
            and of the slide after it.
        place: where something ends it [m, world]; None where nothing does.
        height: how far that thing reaches above what carries the object, at that place [m]; 0 without.
        touching: whether the object touches it from the beginning, and the motion runs into it.
        whole: whether all of the motion is free, to 1 mm.
        angle: by which the object turns on that way [rad]. slid: how far it slides [m].
    """

    length: float
    place: Float[np.ndarray, "3"] | None = None
    height: float = 0.0
    touching: bool = False
    whole: bool = True
    angle: float = 0.0
    slid: float = 0.0

    def __str__(self) -> str:
        turned = [f"{np.degrees(self.angle):.0f} deg"] if self.angle else []
        far = " and ".join([*turned, *([f"{1e3 * self.slid:.0f} mm"] if self.slid or not turned else [])])
        if self.whole or self.place is None:
            return f"free for {far}"
        where = f"({', '.join(f'{each:.3f}' for each in self.place.round(3) + 0.0)}) m"
        if self.touching:
            after = f" after {far}" if turned else ""
            return f"blocked{after} by what it touches at {where}, against which it would move"
        return f"blocked after {far} by something {1e3 * self.height:.0f} mm high at {where}"


@cached_per_instance
def free_way(scene: Scene) -> FreeWay:
    """Return how far the object can be carried along its motion, and what stands in its way; found once per scene.

    While it slides the object is lifted by 1.5 mm, or twice the noise of the surfaces, along the normal of what carries it
    (see `Sweep.first_obstacle`): steps and bumps that are lower are no obstacle, and neither is the drop beyond an edge. Nor
    is what it touches from above or beside, along the motion. While it turns nothing may be in it by more than 1 mm (see
    `first_met`). A support against which the motion leans ends the way at once; the point about which it turns does not.
    """
    motion, turns = scene.object_motion, scene.turn is not None
    stage = motion.turn_length if turns else scene.motion_length
    touching = touching_contacts(scene)
    normal = carrying_normal(touching)
    supports = support_contacts(scene)
    velocity = motion.twist().velocity(supports.points)
    moving = np.linalg.norm(velocity, axis=1) > PIVOT_SPEED
    along = np.where(moving, (supports.normals * velocity).sum(axis=1), 0.0)
    if along.min(initial=0.0) < -MOTION_TOLERANCE:
        place = supports.points[along.argmin()]
        return FreeWay(0.0, place, _height(scene, place, touching, normal), touching=True, whole=False)
    found = first_met(scene, normal, touching.normals, reach=stage)
    if found is not None and found.way < stage - WAY_TOLERANCE:
        height = _height(scene, found.place, touching, normal)
        return _on_the_way(scene, FreeWay(found.way, found.place, height, whole=False))
    if turns and scene.motion_length:
        rest = free_way(scene.carried(stage))
        return _on_the_way(scene, replace(rest, length=stage + rest.length))
    return _on_the_way(scene, FreeWay(stage if found is None else found.way))


def _on_the_way(scene: Scene, way: FreeWay) -> FreeWay:
    """Return the way with the turn and the slide that it consists of."""
    motion = scene.object_motion
    return replace(way, angle=motion.angle(way.length), slid=motion.slid(way.length))


@cached_per_instance
def carried_way(scene: Scene) -> float:
    """Return the way along `scene.motion` [m] for which the object's centre of mass stays above what carries it.

    `scene.motion_length` where it stays so all the way, or is not so at the start. In steps of 5 mm: what of the places in
    which the object rests has something below it, and whether the centre of mass, seen along gravity, is among those. Of an
    object that turns first, once it has.
    """
    if scene.turn is not None and scene.motion_length:
        return carried_way(scene.carried(scene.object_motion.turn_length))
    touching = touching_contacts(scene)
    carrying, normal = touching.points[touching.normals[:, 2] > UPWARD], carrying_normal(touching)
    centre = scene.centre_of_mass
    if not len(carrying) or outside_of(carrying, centre) > TIPPING:
        return scene.motion_length
    corners = hull_corners(carrying, normal, tolerance=WAY_TOLERANCE)
    carrying = np.concatenate([carrying[corners], carrying[:: len(carrying) // MOST_PLACES + 1]])
    lift = sweep_of(scene).lift
    near = faces_near(scene.environment_mesh, scene.way_bounds() + np.array([[-lift], [lift]]))
    rays = Rays(trimesh.Trimesh(scene.environment_mesh.vertices, scene.environment_mesh.faces[near], process=False))
    for way in np.arange(CARRIED_STEP, scene.motion_length, CARRIED_STEP):
        places = carrying + way * scene.motion
        carried = rays.first_hits(places + lift * normal, -normal[None], reach=2 * lift)[1] >= 0
        if not carried.any() or outside_of(places[carried], centre + way * scene.motion) > TIPPING:
            return float(way)
    return scene.motion_length


def outside_of(carrying: Float[np.ndarray, "n 3"], centre: Float[np.ndarray, "3"]) -> float:
    """Return how far a centre of mass is from the convex hull of what carries it [m], both seen from above."""
    rows = np.vstack([carrying[:, :2].T - centre[:2, None], np.full(len(carrying), SUM_WEIGHT)])
    return float(nnls(rows, np.array([0.0, 0.0, SUM_WEIGHT]))[1])  # of the nearest convex combination


def _height(
    scene: Scene, place: Float[np.ndarray, "3"], touching: SupportContacts, normal: Float[np.ndarray, "3"]
) -> float:
    """Return how far what stands at a place reaches above the support [m], or above the object's lowest point."""
    up = normal if normal.any() else np.array([0.0, 0.0, 1.0])
    carrying = touching.points[touching.normals @ up > UPWARD]
    lowest = carrying if len(carrying) else sweep_of(scene).points
    return float(place @ up - (lowest @ up).min()) + sweep_of(scene).height(place, up)
