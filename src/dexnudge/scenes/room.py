"""How much room there is around the object, and whether fingers fit into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.finding import Finding, Level
from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.surface_lattice import faces_near
from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.scene import Scene

REACH = 0.30  # [m] room beyond this is free: more than a hand is wide
FREE = 1e-6  # [m] rounding of a ray that hits nothing
POINTS = 4000  # on the object's surface, evenly spread
SUNK = 1e-3  # [m] surroundings may stand this deep in the object: rays begin so far inside
LOWEST = 0.3  # of the object's height: rays to the sides begin above it, clear of an uneven support
COVERED = 0.95  # share of a side that something stands before, from which it is not mentioned
SIDES = ("in front", "behind", "left", "right", "above")


@dataclass(frozen=True)
class Gap:
    """Room on one side of the object: least and largest [m], at most 0.30, and the share of the side that is not free."""

    side: str
    least: float
    largest: float
    covered: float

    def __str__(self) -> str:
        if not self.covered:
            return f"{self.side} free"
        share = "" if self.covered > COVERED else f" over {self.covered:.0%} of it"
        return f"{self.side} {1e3 * self.least:.0f} mm{share}"


@dataclass(frozen=True)
class Room:
    """What is free around an object: a gap for each side, and the room before each surface point and its share of area."""

    gaps: tuple[Gap, ...]
    gap: Float[np.ndarray, " point"]

    def exposed(self, thickness: float) -> float:
        """Return the share of the object's top and sides before which something `thickness` [m] thick has room."""
        return float((self.gap >= thickness).mean()) if len(self.gap) else 0.0


def room_around(scene: Scene, up: Float[np.ndarray, "3"]) -> Room:
    """Return the room on the sides of a scene's object, found by rays from points on its surface.

    up: unit vector, world; with the motion it says what is in front, behind, left, right and above.
    """
    left = np.cross(up, scene.motion)
    size = float(np.linalg.norm(left))
    left = left / size if size > SUNK else _any_perpendicular(up)
    front = np.cross(left, up)
    directions = np.array([front, -front, left, -left, up, -up])
    body = scene.object_in_world()
    points, face = trimesh.sample.sample_surface(body, POINTS, seed=0)
    side = (np.asarray(body.face_normals)[face] @ directions.T).argmax(axis=1)
    height = points @ up
    tall = height >= height.min() + LOWEST * np.ptp(height)
    rays = _rays_near(scene.environment_mesh, body.bounds)
    gaps, all_ways = [], []
    for index, name in enumerate(SIDES):
        begin = points[(side == index) & (tall | (name == "above"))]
        ways = np.full(len(begin), REACH)
        if rays and len(begin):
            ways = rays(begin - SUNK * directions[index], directions[index], reach=REACH + SUNK) - SUNK
            ways = np.where(ways < REACH - FREE, ways.clip(0.0), REACH)
        if len(ways):
            gaps.append(Gap(name, float(ways.min()), float(ways.max()), float((ways < REACH).mean())))
            all_ways.append(ways)
    return Room(tuple(gaps), np.concatenate([np.zeros(0), *all_ways]))


@cached_per_instance
def thinnest_digit(hand: Hand) -> float:
    """Return the least thickness of the last link of any digit [m]: what a gap must have for a finger to enter."""
    meshes = [hand.link_meshes[index] for index in hand.fingertip_indices]
    return min((_thickness(mesh) for mesh in meshes if len(mesh.faces)), default=0.0)


def room_findings(scene: Scene, hand: Hand | None, up: Float[np.ndarray, "3"]) -> list[Finding]:
    """Return what room there is on each side, and whether the thinnest finger of a hand finds some."""
    room = room_around(scene, up)
    around = "room around the object: " + ", ".join(map(str, room.gaps))
    if hand is None:
        return [Finding("note", "clearance", around)]
    need = thinnest_digit(hand) + scene.clearance
    digit = f"the thinnest finger of {hand.name} needs {1e3 * need:.0f} mm"
    found = [Finding("note", "clearance", f"{around}; {digit}")]
    height = float(np.ptp(scene.object_in_world().vertices @ up))
    if scene.clearance - SUNK > height:  # what touches the object is nearer to its support than that
        sentence = (
            f"no finger may touch the object: it is {1e3 * height:.0f} mm high, and hands keep "
            f"{1e3 * scene.clearance:.0f} mm from what carries it"
        )
        return [*found, Finding("error", "fingers", sentence, "lower `clearance`")]
    largest = max((gap.largest for gap in room.gaps), default=0.0)
    if largest < need:
        # a fingertip is thinner towards its end: half of it may still reach in
        level: Level = "error" if largest < need / 2 else "warning"
        sentence = f"no finger fits anywhere: the largest gap around the object is {1e3 * largest:.1f} mm, {digit}"
        remedy = "make room, lower `clearance`, or use a `hand` with thinner fingers"
        return [*found, Finding(level, "fingers", sentence, remedy)]
    share = room.exposed(need)
    return [*found, Finding("note", "fingers", f"fingers have room at {share:.0%} of the object's top and sides")]


def _thickness(mesh: trimesh.Trimesh) -> float:
    """Return the least width of a convex hull, measured across its faces [m]."""
    hull = mesh.convex_hull
    heights = np.asarray(hull.vertices) @ np.asarray(hull.face_normals).T
    return float(np.ptp(heights, axis=0).min())


def _rays_near(environment: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> Rays | None:
    """Return rays against what of the surroundings lies within reach of the bounds; None where nothing does."""
    near = faces_near(environment, bounds + np.array([[-REACH], [REACH]]))
    if not len(near):
        return None
    corners = np.asarray(environment.vertices)[np.asarray(environment.faces)[near]].reshape(-1, 3)
    return Rays(trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False))


def _any_perpendicular(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    other = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    return other / np.linalg.norm(other)
