"""Where the hand touches the object, and where the surroundings carry it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import distinct_rows, surface_lattice
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.mechanics.support_hull import reduce_supports
from dexnudge.scenes.scene import Scene

HAND_CONTACT_DISTANCE = 2e-3
"""A hand point this close to the object is in contact [m]: what fingertips yield, and what a position controller
closes."""
POINTS_PER_LINK = 4
"""Contact points that stand for one link's patch: enough to carry torque about the normal."""
SUPPORT_DISTANCE = 1e-3
"""An object point this close to the surroundings rests on them [m]: the penetration that a scene may have."""
SUPPORT_REACH = 2 * SUPPORT_DISTANCE
"""Supports are looked for up to here [m]: more than is kept, so that rounding leaves none out."""
SUPPORT_SPACING = 2e-3
"""Spacing of the object's surface points that look for supports [m]."""
FACING_COSINE = -0.1
"""Largest cosine between the object's and the environment's normals of a support contact [-]: opposite surfaces, not
the flank of the object seen by the floor."""
SAME_PLACE = 1e-7
"""Points of the object closer than about this are looked up once [m]."""
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


@dataclass(frozen=True, kw_only=True)
class SupportContacts:
    """Contacts of the object with its surroundings.

    points: on the environment [m, world]. normals: of the environment, from it to the object, unit, world.
    """

    points: Float[np.ndarray, "support 3"]
    normals: Float[np.ndarray, "support 3"]


def hand_contacts(
    normals: Float[np.ndarray, "point 3"],
    link: Int[np.ndarray, "point"],
    *,
    distance: Float[np.ndarray, "point"],
    closest: Float[np.ndarray, "point 3"],
    object_normals: Float[np.ndarray, "point 3"],
) -> HandContacts:
    """Return the contacts of one configuration, from its dense surface points near the object.

    normals: the hand's outward normals. link: the points' link indices. distance [m, negative inside], closest
    [m, world] and object_normals: exact signed distance to the object, closest point on it, and outward normal of its
    nearest triangle. Points farther than 2 mm may be left out.

    A point is a candidate if distance <= 2 mm and the two surfaces face each other (normal . object normal < 0). Of
    each link's candidates up to 4 are kept: the closest one first, then the one whose closest point is farthest from
    those already chosen, so that they spread over the patch.
    """
    facing = np.einsum("px,px->p", normals, object_normals) < 0
    candidates = np.flatnonzero((distance <= HAND_CONTACT_DISTANCE) & facing)
    chosen: list[int] = []
    for index in np.unique(link[candidates]):
        mine = candidates[link[candidates] == index]
        chosen.extend(mine[_spread(closest[mine], distance[mine])])
    return HandContacts(points=closest[chosen], normals=object_normals[chosen], link=link[chosen])


def _spread(points: Float[np.ndarray, "point 3"], distance: Float[np.ndarray, "point"]) -> list[int]:
    """Return up to 4 indices: the least distance first, then farthest-point selection."""
    chosen = [int(np.argmin(distance))]
    gap = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < POINTS_PER_LINK and gap.max() > DISTINCT_DISTANCE:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen


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
def support_contacts(scene: Scene) -> SupportContacts:
    """Return the contacts of a scene's object with its environment, reduced to the extreme ones; found once per scene.

    Looks at points on every triangle of the object, 2 mm apart, its edges and corners included, with that triangle's
    normal. The position is the closest point of the environment: there both bodies meet, and contacts with one plane
    are exactly coplanar. See `reduce_supports` for what may be left out.
    """
    mesh = scene.object_in_world()
    environment = ExactDistance(scene.environment_mesh)
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    near = _near(triangles, environment)
    points, face = surface_lattice(triangles[near], spacing=SUPPORT_SPACING)
    normals = np.asarray(mesh.face_normals, dtype=np.float64)[near][face]
    # neighbouring triangles share corners and edges: each place is looked up once
    first, place = distinct_rows(np.round(points / SAME_PLACE))
    hit = environment.to_surface(points[first], reach=SUPPORT_REACH)
    environment_normals = np.asarray(hit.normal, dtype=np.float64)[place]
    kept = support_mask(normals, distance=hit.distance[place], environment_normals=environment_normals)
    half_length = 0.5 * float(np.max(scene.object_mesh.extents))
    reduced_points, reduced_normals = reduce_supports(
        np.asarray(hit.closest, dtype=np.float64)[place][kept],
        environment_normals[kept],
        half_length=half_length,
    )
    return SupportContacts(points=reduced_points, normals=reduced_normals)


def _near(triangles: Float[np.ndarray, "face 3 3"], environment: ExactDistance) -> Int[np.ndarray, " near"]:
    """Return the triangles of which some point can be a support, and perhaps some others: by a ball around each."""
    centre = triangles.mean(axis=1)
    radius = np.linalg.norm(triangles - centre[:, None], axis=2).max(axis=1)
    reach = radius + SUPPORT_REACH
    return np.flatnonzero(environment.to_surface(centre, reach=float(reach.max())).distance <= reach)
