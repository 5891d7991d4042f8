"""The flat parts of the surroundings that carry or hold an object, fitted to surfaces as they were measured.

The object is swept onto its surroundings; what it would meet within some millimetres is a patch, and planes are fitted to
it robustly (see `plane_fit`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.surface_lattice import distinct_rows, faces_near, surface_lattice
from dexnudge.scenes.plane_fit import (
    EXACT,
    LEAST_POINTS,
    LEVELS_APART,
    MOST_LEAN,
    MOST_STEEP,
    fit_plane,
    plane_noise,
    refined_plane,
    two_levels,
)
from dexnudge.scenes.resting import long_side_along_x
from dexnudge.scenes.support_hull import hull_corners

SPACING = 0.004  # [m] between the points of the object that look for what carries it
FACING = 0.1  # cosine with a direction from which a surface of the object looks that way
MOST_PLANES = 3  # per side: an object lies on a table, over a step, across two boards; more is rough ground
LEAST_SHARE = 0.1  # of the points of a patch that a further plane must explain
ROUGHER = 2.0  # times the noise of the first plane, that a further one may scatter
BUMP = 4.0  # standard deviations from a rough plane within which a surface is a bump of it, and no further support
CORNER_TOLERANCE = 5e-4  # [m] to which a patch's outline is kept

TOUCHING = 1e-3  # [m] an object this near to a plane rests on it, or is held by it

Side = Literal["below", "above", "beside"]


@dataclass(frozen=True)
class Support:
    """A flat part of the surroundings.

    Attributes:
        normal: unit, toward the object, world. offset: `normal` . x on the plane [m].
        noise: by which the measured surface scatters about it, root mean square [m]; 0 for a model.
        area: of the outline of the patch that the object meets [m^2]. corners: of that outline, in order [m, world].
        side: where the object has it.
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    noise: float
    area: float
    corners: Float[np.ndarray, "k 3"]
    side: Side

    def height(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return how far points [m, world] lie above the plane, on the object's side [m]."""
        return points @ self.normal - self.offset

    @property
    def tilt(self) -> float:
        """Angle between the plane and a level one [deg]."""
        return float(np.degrees(np.arccos(min(1.0, abs(float(self.normal[2]))))))


def all_supports(
    body: trimesh.Trimesh,
    surroundings: trimesh.Trimesh,
    *,
    below: float,
    around: float = TOUCHING,
) -> tuple[Support, ...]:
    """Return what a body [m, world] meets within `below` [m] under it, and within `around` [m] above and beside it.

    Beside is along the sides of the smallest rectangle around it, seen from above.
    """
    down = np.array([0.0, 0.0, -1.0])
    across = long_side_along_x(np.asarray(body.convex_hull.vertices)[:, :2])[:2]
    found = fit_supports(body, surroundings, down, side="below", reach=below)
    found = found[:1] + [each for each in found[1:] if _is_level(found[0], each)]
    others = _without_noise_of(found, surroundings)
    found += fit_supports(body, others, -down, side="above", reach=around)
    for direction in (*across, *-across):
        found += fit_supports(body, others, direction, side="beside", reach=around)
    return tuple(found)


def _is_level(first: Support, other: Support) -> bool:
    """Return whether another surface is no bump of the first: out of its noise, or parallel and apart on average."""
    apart = abs(float(first.height(other.corners).mean()))
    parallel = first.normal @ other.normal > np.cos(np.radians(MOST_LEAN))
    return bool(parallel and apart > LEVELS_APART * first.noise) or not _is_noise_of([first], other.corners).all()


def _is_noise_of(supports: list[Support], points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Return which points [m, world] are bumps of surfaces that scatter, seen from whichever side."""
    bumps = np.zeros(len(points), dtype=bool)
    for support in supports:
        if support.noise > EXACT:
            bumps |= np.abs(support.height(points)) <= BUMP * support.noise
    return bumps


def _without_noise_of(supports: list[Support], surroundings: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the surroundings without the bumps of what carries the object: their flanks hold nothing from beside."""
    kept = ~_is_noise_of(supports, np.asarray(surroundings.vertices))[surroundings.faces].all(axis=1)
    if kept.all():
        return surroundings
    return trimesh.Trimesh(surroundings.vertices, surroundings.faces[kept], process=False)


def fit_supports(
    body: trimesh.Trimesh,
    surroundings: trimesh.Trimesh,
    direction: Float[np.ndarray, "3"],
    *,
    side: Side,
    reach: float,
) -> list[Support]:
    """Return the planes that a body [m, world] meets within `reach` [m] in the unit `direction`, largest patch first.

    Also those that it already stands in, by as much.
    """
    points, face = _met(body, surroundings, direction, reach=reach)
    found: list[Support] = []
    left = np.arange(len(points))
    while len(left) >= max(LEAST_POINTS, LEAST_SHARE * len(points)) and len(found) < MOST_PLANES:
        normal, offset, mine = fit_plane(points[left], -direction)
        if np.count_nonzero(mine) < max(LEAST_POINTS, LEAST_SHARE * len(points)):
            break
        if normal @ -direction > MOST_STEEP:
            on_plane = points[left[mine]]
            measured = plane_noise(on_plane, surroundings, face[left[mine]], normal, offset)
            if not found and (levels := two_levels(surroundings, face, points, normal, measured)):
                for level in levels:
                    corners = level.points[hull_corners(level.points, level.normal, tolerance=CORNER_TOLERANCE)]
                    area = _outline_area(corners)
                    found.append(Support(level.normal, level.offset, level.noise, area, corners, side))
                break
            normal, offset = refined_plane(surroundings, on_plane, normal, offset, measured)
            if found and measured > ROUGHER * max(found[0].noise, EXACT):  # what is left over, and no surface
                break
            corners = on_plane[hull_corners(on_plane, normal, tolerance=CORNER_TOLERANCE)]
            found.append(Support(normal, offset, measured, _outline_area(corners), corners, side))
        left = left[~mine]
    return sorted(found, key=lambda support: -support.area)


def _met(
    body: trimesh.Trimesh, surroundings: trimesh.Trimesh, direction: Float[np.ndarray, "3"], *, reach: float
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Return points of the surroundings that face the body and that it meets, and the face of each."""
    near = faces_near(surroundings, body.bounds + np.array([[-reach], [reach]]))
    if len(near) == 0:
        return np.zeros((0, 3)), near
    points = facing_points(body, direction)
    rays = Rays(trimesh.Trimesh(surroundings.vertices, surroundings.faces[near], process=False))
    normals = np.asarray(surroundings.face_normals)[near]
    way, face = nearest_surface(points, rays, normals, direction, reach=reach)
    met = face >= 0
    return points[met] + way[met, None] * direction, near[face[met]]


def nearest_surface(
    points: Float[np.ndarray, "n 3"],
    rays: Rays,
    normals: Float[np.ndarray, "face 3"],
    direction: Float[np.ndarray, "3"],
    *,
    reach: float,
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the way [m] from each point along a direction to the nearest surface that faces it, and that face.

    The way is negative to a surface that lies behind: the point stands in it. Infinite, and face -1, where there is none.
    """
    way, face = np.full(len(points), np.inf), np.full(len(points), -1)
    for sign in (1.0, -1.0):
        length, hit = rays.first_hits(points, (sign * direction)[None], reach=reach)
        nearer = (hit >= 0) & (normals[hit] @ direction < 0) & (length < np.abs(way))
        way[nearer], face[nearer] = sign * length[nearer], hit[nearer]
    return way, face


def facing_points(body: trimesh.Trimesh, direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
    """Return points of a body's surface that look in a direction [m], edges and corners among them, each once."""
    facing = np.asarray(body.face_normals) @ direction > FACING
    points = surface_lattice(np.asarray(body.triangles, dtype=np.float64)[facing], spacing=SPACING)[0]
    return points[np.sort(distinct_rows(np.round(points * 1e6))[0])] if len(points) else points


def _outline_area(corners: Float[np.ndarray, "k 3"]) -> float:
    """Return the area of a convex polygon in space [m^2]."""
    if len(corners) < 3:
        return 0.0
    spokes = corners[1:] - corners[0]
    return float(0.5 * np.linalg.norm(np.cross(spokes[:-1], spokes[1:]).sum(axis=0)))
