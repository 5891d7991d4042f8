"""What is found out about a scene before anything is sampled: what was understood, what is odd, what cannot work."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.finding import Finding, length_text, vector_text
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.mesh_repair import parts
from dexnudge.geometry.surface_lattice import distinct_rows, faces_near, surface_lattice
from dexnudge.hands.hand import Hand
from dexnudge.scenes.free_way import TIPPING, carried_way, free_way, outside_of
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.placement import size_findings
from dexnudge.scenes.plane_fit import EXACT
from dexnudge.scenes.room import room_findings
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import (
    MOTION_TOLERANCE,
    UPWARD,
    SupportContacts,
    carrying_normal,
    touching_contacts,
)
from dexnudge.scenes.sweep import sweep_of

ORDER = {"error": 0, "warning": 1, "note": 2}
UP = np.array([0.0, 0.0, 1.0])
LEVEL = 0.05  # [deg] what leans by less is called level
SETTLED = (1.0, 0.5)  # [mm, deg] an object that was moved by more was not where its pose said
SAID_FROM = (0.05, 0.05)  # [mm, deg] less is zero in a sentence
MASKED = "masked points"  # in the notes of an object that is known from them
SAID = ("(`settle` off", "does not come to rest")  # in notes of the surroundings that findings say as well
STEEP = np.radians(15.0)  # a motion off its support by more lifts the object; one into it was meant so
MOST_NAMED = 3  # free directions in one message
DIRECTIONS = 8  # in the plane of the support that are tried where the way is not free
SHORTEST_WAY = 0.02  # [m] a shorter motion is not worth proposing
NEAR = 0.10  # [m] around object and way, of which it is said how much was seen
SMALLEST_AREA = 1e-12  # [m^2]


def scene_findings(scene: Scene, hand: Hand | None = None) -> list[Finding]:
    """Return the findings about a scene, errors first; see `Scene.findings`."""
    found = [*reading_findings(scene), *scene.misplaced]
    if not scene.misplaced:
        touching = touching_contacts(scene)
        normal = carrying_normal(touching)
        found += [*_settled(scene), *_supports(scene)]
        found += _carried(scene, touching)
        found += _way(scene, normal) if normal.any() else []
        found += room_findings(scene, hand, normal if normal.any() else UP)
    found += _seen(scene)
    return sorted(found, key=lambda finding: ORDER[finding.level])


def reading_findings(scene: Scene) -> list[Finding]:
    """Return what the meshes were taken for: their sizes, parts that lie apart, and what was repaired."""
    sizes = size_findings(scene.object_mesh, scene.environment_mesh, scene.mass)
    return [
        *(finding for finding in sizes if finding.level != "error"),
        *loose_parts_findings(scene.object_mesh),
        *(Finding("note", "repaired", note) for note in scene.notes if not any(said in note for said in SAID)),
    ]


def _settled(scene: Scene) -> Iterator[Finding]:
    """Yield how far the object was moved to come to rest."""
    shift, turn = (float(scene.parameters.get(key, 0.0)) for key in ("settled_mm", "settled_deg"))
    if not shift and not turn:
        return
    tilted = f"tilted by {turn:.1f} degrees"
    if abs(shift) < SAID_FROM[0]:
        sentence = f"the object was {tilted} onto what carries it" if turn >= SAID_FROM[1] else ""
    elif shift > 0:
        sentence = f"the object stood {shift:.1f} mm inside what carries it, and was raised onto it"
    else:
        sentence = (
            f"the object touched nothing: the nearest surface was {-shift:.1f} mm below it, and it was lowered onto it"
        )
    if not sentence:
        return
    if abs(shift) >= SAID_FROM[0] and turn >= SAID_FROM[1]:
        sentence += f", {tilted}"
    if abs(shift) <= SETTLED[0] and turn <= SETTLED[1]:
        yield Finding("note", "settled", sentence)
        return
    masked = any(MASKED in note for note in scene.notes)
    mend = "give a mesh and its `object_pose`" if masked else "mend the `object_pose`"
    remedy = f"{mend} if that is not what happened, or keep it by `settle` off"
    yield Finding("warning", "settled", sentence, remedy)


def _supports(scene: Scene) -> Iterator[Finding]:
    """Yield the planes that the object touches, and what their noise means."""
    for support in scene.supports:
        middle = np.asarray(support.corners).mean(axis=0)
        lies = "level" if support.tilt < LEVEL else f"{support.tilt:.1f} degrees from level"
        noise = f", noise {1e3 * support.noise:.2g} mm" if support.noise > EXACT else ""
        where = f"a plane {support.side} the object at {vector_text(middle, digits=3)} m"
        yield Finding("note", "supports", f"{where}, {lies}, contact area {1e4 * support.area:.0f} cm^2{noise}")
    if scene.surface_noise > 0:
        yield Finding(
            "note",
            "supports",
            f"the surfaces scatter by {1e3 * scene.surface_noise:.1f} mm: hands keep {1e3 * scene.clearance:.1f} mm clear",
        )


def _carried(scene: Scene, touching: SupportContacts) -> Iterator[Finding]:
    """Yield what is wrong with what carries the object: nothing from below, or not under its centre of mass."""
    below = touching.points[touching.normals[:, 2] > UPWARD]
    if not len(below):
        above = bool((touching.normals[:, 2] < -UPWARD).any())
        where = "above" if above else "beside"
        remedy = "is the scan upside down? z points up and gravity down" if above else "mend the `object_pose`"
        yield Finding(
            "error",
            "carried",
            f"nothing carries the object: what it touches is {where} it, and nothing below; expected a surface under it",
            f"{remedy}, or add what carries it to the `environment`",
        )
        return
    centre = scene.centre_of_mass
    outside = outside_of(below, centre)
    if outside > TIPPING:
        yield Finding(
            "warning",
            "carried",
            f"the object would tip: its centre of mass, at {vector_text(centre, digits=3)} m, is "
            f"{length_text(outside)} outside of what carries it",
            "mend the `object_pose`, or the `environment` where it is cut off",
        )


def _way(scene: Scene, normal: Float[np.ndarray, "3"]) -> Iterator[Finding]:
    """Yield how far the object can go, and where it could go instead."""
    way, asked = free_way(scene), _motion_text(scene)
    if way.whole:
        yield Finding("note", "free_way", f"the way {asked} is {way}")
        if scene.turn is not None and abs(scene.turn.axis @ normal) < UPWARD:
            yield Finding("note", "free_way", _tipping(scene, scene.turn))
        if (carried := carried_way(scene)) < scene.motion_length:
            yield Finding(
                "note",
                "free_way",
                f"after {1e3 * carried:.0f} mm the object's centre of mass is beyond what carries it; `execute` stops "
                "before where the object can be grasped, else it falls",
            )
        rise = float(np.arcsin(np.clip(scene.motion @ normal, -1.0, 1.0)))
        if rise > STEEP:
            yield Finding(
                "warning",
                "motion",
                f"the motion {vector_text(scene.motion, digits=2)} leaves what carries the object at {_degrees(rise)}: it "
                "lifts, not slides",
                "give a `motion` along the support",
            )
        return
    turned = scene.object_motion.turn_length
    if scene.turn is not None and way.length < turned:
        yield Finding("error", "free_way", f"the way {asked} is {way}", _other_turns(scene.turn, normal, way.angle))
        return
    there = scene.carried(turned) if turned else scene
    touching = touching_contacts(there)
    normal = carrying_normal(touching)
    others = _other_ways(there, touching, normal)
    dip = float(np.arcsin(np.clip(-there.motion @ normal, -1.0, 1.0)))
    if dip > (MOTION_TOLERANCE if way.touching else STEEP):
        yield Finding(
            "error",
            "motion",
            f"the motion {vector_text(scene.motion, digits=2)} leads {_degrees(dip)} into what carries the object; expected "
            "one along it",
            f"choose another `motion`: {others}",
        )
        return
    shorter = 1e-3 * np.floor(1e3 * way.slid)
    remedy = (
        f"shorten `motion_length` to {shorter:g}, or choose another `motion`: "
        if shorter >= SHORTEST_WAY
        else ("choose another `motion`: ")
    )
    yield Finding(
        "error",
        "free_way",
        f"the way {asked} is {way}; expected {1e3 * scene.motion_length:.0f} mm",
        remedy + others,
    )


def _motion_text(scene: Scene) -> str:
    """Return the motion in words, to stand after "the way"."""
    slide = f"along {vector_text(scene.motion, digits=2)}"
    if scene.turn is None:
        return slide
    axis = f"{vector_text(scene.turn.axis, digits=2)} through {vector_text(scene.turn.point, digits=3)} m"
    turn = f"of a turn by {np.degrees(scene.turn.angle):.0f} deg about {axis}"
    return f"{turn}, then {slide}," if scene.motion_length else turn


def _tipping(scene: Scene, turn: Turn) -> str:
    """Return from where on the object would fall over by itself, its centre of mass beyond the edge that it tips over."""
    arm = scene.centre_of_mass - turn.point
    moment, growth = (float(np.cross(each, -UP) @ turn.axis) for each in (arm, np.cross(turn.axis, arm)))
    over = float(np.arctan2(-moment, growth))
    if 0 <= over < turn.angle:
        return (
            f"from {np.degrees(over):.0f} deg on the object's centre of mass is beyond the edge that it tips over: it would "
            "fall over by itself if the hand let it"
        )
    return "its centre of mass stays behind the edge that it tips over: it falls back where the hand lets it"


def _other_turns(turn: Turn, normal: Float[np.ndarray, "3"], free: float) -> str:
    """Return what to do about a turn that is free for an angle [rad] alone."""
    least = f"by at most {np.floor(np.degrees(free)):.0f} deg, " if np.degrees(free) >= 1.0 else ""
    if abs(turn.axis @ normal) < UPWARD:
        return f"tip it {least}over another edge by another `motion`, or make room where it sinks"
    return f"turn it {least}the other way round, or about another point by `about`"


def _degrees(angle: float) -> str:
    """Return an angle [rad] in words; a small one with a decimal, never as 0 or 1 degrees."""
    degrees = float(np.degrees(angle))
    return f"{degrees:.1f} degrees" if degrees < 2 else f"{degrees:.0f} degrees"


def _other_ways(scene: Scene, touching: SupportContacts, normal: Float[np.ndarray, "3"]) -> str:
    """Return which of eight directions along the support are free, or how far the best of them leads."""
    up = normal if normal.any() else UP
    first = scene.motion - (scene.motion @ up) * up
    if np.linalg.norm(first) < MOTION_TOLERANCE:
        first = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    lengths: dict[str, float] = {}
    for angle in np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS:
        direction = np.cos(angle) * first + np.sin(angle) * second
        opposed = (touching.normals @ direction).min(initial=0.0) < -np.sin(STEEP)
        found = sweep_of(scene).first_obstacle(
            direction, carrying=normal, touching=touching.normals, reach=scene.motion_length
        )
        length = 0.0 if opposed else scene.motion_length if found is None else found.way
        lengths[vector_text(direction, digits=2)] = length
    free = [direction for direction, length in lengths.items() if length >= scene.motion_length]
    if free:
        others = f" and {len(free) - MOST_NAMED} others" if len(free) > MOST_NAMED else ""
        return f"{', '.join(free[:MOST_NAMED])}{others} {'is' if len(free) == 1 else 'are'} free"
    best = max(lengths, key=lambda direction: lengths[direction])
    return f"the longest of {DIRECTIONS} ways leads {1e3 * lengths[best]:.0f} mm, along {best}"


def _seen(scene: Scene) -> Iterator[Finding]:
    """Yield how much of surroundings from depth images was never measured."""
    mesh = scene.environment_mesh
    if "origin" in mesh.metadata:
        near = faces_near(mesh, np.asarray(scene.way_bounds()) + np.array([[-NEAR], [NEAR]]))
        corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)[near]]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        origin = np.asarray(mesh.metadata["origin"])[near]
        share = np.bincount(origin, weights=area, minlength=3) / max(float(area.sum()), SMALLEST_AREA)
        shares = f"{share[0]:.0%} was seen, {share[1]:.0%} is assumed, {share[2]:.0%} bounds what was not seen"
        yield Finding("note", "seen", f"of the surface around object and way {shares}")


APART = 0.1  # of the object's longest side: keys, lids and the parts of an assembly lie nearer to one another
SPACING = 0.02  # of the same, between the points from which a gap is measured


def loose_parts_findings(object_mesh: trimesh.Trimesh) -> list[Finding]:
    """Return a warning where parts of an object are farther than a tenth of its length from those around its largest one."""
    faces = distinct_rows(np.asarray(object_mesh.vertices))[1][object_mesh.faces]
    part = parts(faces)
    count, length = int(part.max()) + 1, float(object_mesh.extents.max())
    if count == 1:
        return []
    points, face = surface_lattice(np.asarray(object_mesh.triangles), spacing=SPACING * length)[:2]
    owner = part[face]
    added = np.arange(count) == np.bincount(part, object_mesh.area_faces).argmax()
    away = np.full(count, np.inf)  # from the nearest part that belongs to the largest one
    belongs = np.zeros(count, dtype=bool)
    while added.any():
        belongs |= added
        near = trimesh.Trimesh(object_mesh.vertices, object_mesh.faces[added[part]], process=False)
        others = ~belongs[owner]
        np.minimum.at(away, owner[others], ExactDistance(near).to_surface(points[others], reach=2 * length).distance)
        added = ~belongs & (away <= APART * length)
    if belongs.all():
        return []
    loose, gap = np.count_nonzero(~belongs), float(away[~belongs].min())
    which = "a part of the object lies" if loose == 1 else f"{loose} parts of the object lie"
    sentence = (
        f"{which} {length_text(gap)} away from the rest, {gap / length:.0%} of its length; they count as one body"
    )
    return [Finding("warning", "size", sentence, "if they are several things, leave one of them in the mesh")]
