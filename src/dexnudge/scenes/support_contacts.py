"""Where the surroundings carry the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.finding import vector_text
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import Boxes, distinct_rows, lattice_in_boxes, surface_lattice
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_hull import HULL_TOLERANCE, TURNING_TOLERANCE, reduce_supports
from dexnudge.scenes.sweep import first_met, triangles_in_box

SUPPORT_DISTANCE = 1e-3
"""An object point this close to the surroundings rests on them [m]: the penetration that a scene may have."""
SUPPORT_REACH = 2 * SUPPORT_DISTANCE
"""Supports are looked for up to here [m]: more than is kept, so that rounding leaves none out."""
SUPPORT_SPACING = 2e-3
"""Spacing of the object's surface points that look for supports [m]."""
FACING_COSINE = -0.1
"""Largest cosine between the object's and the environment's normals of a support contact [-]: opposite surfaces, not
the flank of the object seen by the floor."""
UPWARD = 0.5
"""z of a normal from which a contact can carry [-]."""
UPRIGHT = 0.99
"""Cosine of a turn's axis with the support's normal from which the object turns in place [-]."""
LEAST_HEADING = np.radians(30.0)
"""Angle between a motion and the normal of what carries the object below which it has no direction along that."""
MOTION_TOLERANCE = 1e-3
"""|n . u| up to which a support contact counts as sliding, above as separating or blocking [-]."""
PIVOT_SPEED = 0.02
"""Speed of a support contact over the object's fastest point up to which it counts as standing [-]: an edge that is
rounded by 2 mm, about which 100 mm tip, or a point near the axis of a turn."""
MOST_LEAN = -0.34
"""n . u down to which a normal of a noisy surface, 20 degrees off, is taken for noise [-]: 1 mm over edges of 3 mm."""
SAME_PLACE = 1e-7
"""Points of the object closer than about this are looked up once [m]."""


@dataclass(frozen=True, kw_only=True)
class SupportContacts:
    """Contacts of the object with its surroundings.

    points: on the environment [m, world]. normals: of the environment, from it to the object, unit, world.
    """

    points: Float[np.ndarray, "support 3"]
    normals: Float[np.ndarray, "support 3"]


def support_mask(
    object_normals: Float[np.ndarray, "point 3"],
    *,
    distance: Float[np.ndarray, "point"],
    environment_normals: Float[np.ndarray, "point 3"],
) -> Bool[np.ndarray, "point"]:
    """Return which of the object's surface points rest on the environment.

    Those within 1 mm of it (either side: `distance` [m] is signed) whose surfaces face each other: cosine between
    the normals <= -0.1. So the underside of an object beside a wall rests on the floor and not on the wall.
    """
    facing = np.einsum("px,px->p", object_normals, environment_normals) <= FACING_COSINE
    return (np.abs(distance) <= SUPPORT_DISTANCE) & facing


@cached_per_instance
def touching_contacts(scene: Scene) -> SupportContacts:
    """Return where a scene's object touches its environment, with the environment's own normals; found once per scene.

    Looks at points on every triangle of the object, 2 mm apart, its edges and corners included, with that triangle's
    normal. The position is the closest point of the environment: there both bodies meet, and contacts with one plane
    are exactly coplanar. Of an object that turns, also the surroundings' own points, their edges included: it may turn
    about one of those.
    """
    mesh = scene.object_in_world()
    environment = surroundings_distance(scene.environment_mesh)
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    near = _near(triangles, environment)
    points, face = surface_lattice(triangles[near], spacing=SUPPORT_SPACING)
    normals = np.asarray(mesh.face_normals, dtype=np.float64)[near][face]
    # neighbouring triangles share corners and edges: each place is looked up once
    first, place = distinct_rows(np.round(points / SAME_PLACE))
    hit = environment.to_surface(points[first], reach=SUPPORT_REACH)
    environment_normals = np.asarray(hit.normal, dtype=np.float64)[place]
    kept = support_mask(normals, distance=hit.distance[place], environment_normals=environment_normals)
    found = SupportContacts(
        points=np.asarray(hit.closest, dtype=np.float64)[place][kept], normals=environment_normals[kept]
    )
    return found if scene.turn is None else _with_own_points(found, mesh, scene, environment)


@cached_per_instance
def support_contacts(scene: Scene) -> SupportContacts:
    """Return the contacts of a scene's object with its environment, reduced to the extreme ones; found once per scene.

    Where surfaces are noisy (`scene.surface_noise`), one triangle that leans against the motion does not oppose it: up to 20
    degrees its normal is made perpendicular to the motion there; one that leans more is left out if the object can be
    carried past it, lifted by twice the noise where it slides. See `reduce_supports` for what else may be left out.
    """
    found = touching_contacts(scene)
    if scene.surface_noise > 0:
        found = _without_noise(scene, found)
    half_length = 0.5 * float(np.max(scene.object_mesh.extents))
    tolerance = TURNING_TOLERANCE if turns_in_place(scene) else HULL_TOLERANCE
    points, normals = reduce_supports(found.points, found.normals, half_length=half_length, tolerance=tolerance)
    return SupportContacts(points=points, normals=normals)


def turns_in_place(scene: Scene) -> bool:
    """Return whether the object first turns about the normal of what carries it."""
    return scene.turn is not None and abs(float(scene.turn.axis @ carrying_normal(touching_contacts(scene)))) > UPRIGHT


def carrying_normal(contacts: SupportContacts) -> Float[np.ndarray, "3"]:
    """Return the mean normal of the contacts that can carry the object, unit; zeros where there is none."""
    normals = contacts.normals[contacts.normals[:, 2] > UPWARD]
    return normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0)) if len(normals) else np.zeros(3)


def without_heading(motion: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> str:
    """Return what is wrong with a motion within 30 degrees of the normal of what carries the object; "" for any other.

    Where along the support it should lead would be a guess.
    """
    rise = float(motion @ normal)
    if abs(rise) <= np.cos(LEAST_HEADING):
        return ""
    degrees, way = np.degrees(np.arcsin(min(1.0, abs(rise)))), "into" if rise < 0 else "off"
    return (
        f"the motion {vector_text(motion, digits=2)} leads {degrees:.0f} degrees {way} what carries the object; expected "
        "one along it"
    )


def _with_own_points(
    found: SupportContacts, body: trimesh.Trimesh, scene: Scene, environment: ExactDistance
) -> SupportContacts:
    """Return contacts and those at the surroundings' own points near the body [m, world], such as those of a table's rim."""
    low, high = body.bounds + np.array([[-SUPPORT_DISTANCE], [SUPPORT_DISTANCE]])
    triangles = triangles_in_box(scene.environment_mesh, low, high)
    box = Boxes((low + high)[None] / 2, np.eye(3)[None], (high - low)[None] / 2)
    points, _, face = lattice_in_boxes(triangles, box, spacing=SUPPORT_SPACING)
    if not len(points):
        return found
    sides = triangles[face, 1:] - triangles[face, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    hit = ExactDistance(body).to_surface(points, reach=SUPPORT_REACH)
    kept = support_mask(np.asarray(hit.normal, dtype=np.float64), distance=hit.distance, environment_normals=normals)
    # A point beside the body carries nothing.
    met = environment.to_surface(hit.closest[kept], reach=SUPPORT_REACH).closest
    return SupportContacts(
        points=np.concatenate([found.points, met]), normals=np.concatenate([found.normals, normals[kept]])
    )


def _without_noise(scene: Scene, found: SupportContacts) -> SupportContacts:
    """Return the contacts as the sweep along the motion has them."""
    motion = scene.object_motion.twist().direction(found.points)
    along = found.normals @ scene.motion if scene.turn is None else (found.normals * motion).sum(axis=1)
    opposing = along <= MOST_LEAN
    if opposing.any():
        reach = SUPPORT_DISTANCE + 2 * scene.surface_noise  # farther off, what opposes the object does not touch it
        opposing &= first_met(scene, carrying_normal(found), found.normals, reach=reach) is None
    leaning = (along < -MOTION_TOLERANCE) & (along > MOST_LEAN)
    level = found.normals - (leaning * along)[:, None] * motion
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    normals = np.where(leaning[:, None], level, found.normals)
    return SupportContacts(points=found.points[~opposing], normals=normals[~opposing])


def _near(triangles: Float[np.ndarray, "face 3 3"], environment: ExactDistance) -> Int[np.ndarray, " near"]:
    """Return the triangles of which some point can be a support, and perhaps some others: by a ball around each."""
    centre = triangles.mean(axis=1)
    radius = np.linalg.norm(triangles - centre[:, None], axis=2).max(axis=1)
    reach = radius + SUPPORT_REACH
    return np.flatnonzero(environment.to_surface(centre, reach=float(reach.max())).distance <= reach)
