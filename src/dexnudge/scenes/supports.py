"""The flat parts of the surroundings that carry or hold an object, fitted to surfaces as they were measured.

The object is swept onto its surroundings; what it would meet within some millimetres is a patch, and planes are fitted to
it robustly: least median of squares (Rousseeuw, 1984), then least squares over what agrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.surface_lattice import distinct_rows, surface_lattice
from dexnudge.scenes.resting import long_side_along_x
from dexnudge.scenes.support_hull import hull_corners

SPACING = 0.004  # [m] between the points of the object that look for what carries it
FACING = 0.1  # cosine with a direction from which a surface of the object looks that way
MOST_PLANES = 3  # per side: an object lies on a table, over a step, across two boards; more is rough ground
LEAST_POINTS = 12  # of a patch; fewer make no plane
LEAST_SHARE = 0.1  # of the points of a patch that a further plane must explain
ROUGHER = 2.0  # times the noise of the first plane, that a further one may scatter
TRIPLES = 300  # of points tried; half of the points may belong to no plane and one of them is good all the same
OUTLIER = 2.5  # standard deviations from which a point is not of the plane
BUMP = 4.0  # standard deviations from a rough plane within which a surface is a bump of it, and no further support
MAD_TO_DEVIATION = 1.4826  # standard deviation of a normal distribution over its median absolute value
EXACT = 2e-5  # [m] residuals below it are rounding of a file with five decimals, and no noise
STRAY = 6.0  # standard deviations by which a single measurement may be off, amid others that are not
FEW_VERTICES = 30  # below which the noise is read off the patch itself, not off its vertices
CORNER_TOLERANCE = 5e-4  # [m] to which a patch's outline is kept
OF_AN_EDGE = 0.3  # cosine with a plane's normal below which a face is of a wall or an edge
REFITS = 6  # of a plane to a wider surface
WIDER = 0.10  # [m] around a patch, where the same surface is looked for
MOST_STEEP = 0.5  # cosine between a support's normal and the direction that it faces

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
    noise: float | None = None,
) -> tuple[Support, ...]:
    """Return what a body [m, world] meets within `below` [m] under it, and within `around` [m] above and beside it.

    Beside is along the sides of the smallest rectangle around it, seen from above. `noise` [m]: see `fit_supports`.
    """
    down = np.array([0.0, 0.0, -1.0])
    across = long_side_along_x(np.asarray(body.convex_hull.vertices)[:, :2])[:2]
    found = fit_supports(body, surroundings, down, side="below", reach=below, noise=noise)
    found = found[:1] + [each for each in found[1:] if not _is_noise_of(found[:1], each.corners).all()]
    others = _without_noise_of(found, surroundings)
    found += fit_supports(body, others, -down, side="above", reach=around, noise=noise)
    for direction in (*across, *-across):
        found += fit_supports(body, others, direction, side="beside", reach=around, noise=noise)
    return tuple(found)


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
    noise: float | None = None,
) -> list[Support]:
    """Return the planes that a body [m, world] meets within `reach` [m] in the unit `direction`, largest patch first.

    Also those that it already stands in, by as much. `noise` [m], where it is known, takes the place of the measured one.
    """
    points, face = _met(body, surroundings, direction, reach=reach)
    found: list[Support] = []
    left = np.arange(len(points))
    while len(left) >= max(LEAST_POINTS, LEAST_SHARE * len(points)) and len(found) < MOST_PLANES:
        normal, offset, mine = _plane(points[left], -direction)
        if np.count_nonzero(mine) < max(LEAST_POINTS, LEAST_SHARE * len(points)):
            break
        if normal @ -direction > MOST_STEEP:
            on_plane = points[left[mine]]
            measured = _noise(on_plane, surroundings, face[left[mine]], normal, offset)
            normal, offset = _refined(surroundings, on_plane, normal, offset, measured)
            if found and measured > ROUGHER * max(found[0].noise, EXACT):  # what is left over, and no surface
                break
            scatter = measured if noise is None else noise
            corners = on_plane[hull_corners(on_plane, normal, tolerance=CORNER_TOLERANCE)]
            found.append(Support(normal, offset, scatter, _outline_area(corners), corners, side))
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
    found, faces = [], []
    for sign in (1.0, -1.0):  # ahead, and behind: where the body stands in what should carry it
        way, face = rays.first_hits(points, (sign * direction)[None], reach=reach)
        kept = (face >= 0) & (normals[face] @ direction < 0)
        found.append(points[kept] + sign * way[kept, None] * direction)
        faces.append(near[face[kept]])
        points = points[~kept]
    return np.concatenate(found), np.concatenate(faces)


def faces_near(mesh: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> Int[np.ndarray, " near"]:
    """Return the faces of a mesh whose boxes touch the given bounds [m]; few operations for each vertex of a large mesh."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    near = np.arange(len(faces))
    for axis in range(3):
        for outside in (vertices[:, axis] < bounds[0, axis], vertices[:, axis] > bounds[1, axis]):
            near = near[~outside[faces[near]].all(axis=1)]
    return near


def facing_points(body: trimesh.Trimesh, direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 3"]:
    """Return points of a body's surface that look in a direction [m], edges and corners among them, each once."""
    facing = np.asarray(body.face_normals) @ direction > FACING
    points = surface_lattice(np.asarray(body.triangles, dtype=np.float64)[facing], spacing=SPACING)[0]
    return points[np.sort(distinct_rows(np.round(points * 1e6))[0])] if len(points) else points


def _plane(
    points: Float[np.ndarray, "n 3"], toward: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], float, Bool[np.ndarray, " n"]]:
    """Return (unit normal, offset [m], which points agree) of the plane of least median distance."""
    generator = np.random.default_rng(0)
    corners = points[generator.integers(len(points), size=(TRIPLES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-9 * float(np.ptp(points, axis=0).max()) ** 2
    if not usable.any():
        return toward, 0.0, np.zeros(len(points), dtype=bool)
    normals = normals[usable] / length[usable, None]
    distance = np.abs(points @ normals.T - np.einsum("kx,kx->k", normals, corners[usable, 0]))
    median = np.median(distance, axis=0)
    best = int(np.argmin(median))
    inside = distance[:, best] <= max(OUTLIER * MAD_TO_DEVIATION * median[best], EXACT)
    normal, offset = toward, 0.0
    for _ in range(3):
        centre = points[inside].mean(axis=0)
        normal = np.linalg.svd(points[inside] - centre, full_matrices=False)[2][-1]
        normal = normal if normal @ toward > 0 else -normal
        offset = float(normal @ centre)
        distance = np.abs(points @ normal - offset)
        inside = distance <= max(OUTLIER * MAD_TO_DEVIATION * float(np.median(distance[inside])), EXACT)
    return normal, offset, inside


def _noise(
    points: Float[np.ndarray, "n 3"],
    surroundings: trimesh.Trimesh,
    face: Int[np.ndarray, " n"],
    normal: Float[np.ndarray, "3"],
    offset: float,
) -> float:
    """Return the scatter of the measured vertices about a plane [m]: between them a surface is smoother than they are."""
    vertices = np.asarray(surroundings.vertices)[np.unique(surroundings.faces[np.unique(face)])]
    measured = vertices if len(vertices) >= FEW_VERTICES else points
    distance = np.abs(measured @ normal - offset)
    scatter = MAD_TO_DEVIATION * float(np.median(distance))
    kept = distance[distance <= max(OUTLIER * scatter, EXACT)]
    return max(scatter, float(np.sqrt(np.mean(kept**2)))) if scatter > EXACT else float(np.sqrt(np.mean(kept**2)))


def _refined(
    surroundings: trimesh.Trimesh,
    patch: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "3"],
    offset: float,
    noise: float,
) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the plane fitted to the measured vertices around a patch as well: a longer lever, a smaller angle.

    The same plane where it is exact, or where the surface around does not go on as flat.
    """
    if noise <= EXACT:
        return normal, offset
    centre = 0.5 * (patch.min(axis=0) + patch.max(axis=0))
    half = 0.5 * np.ptp(patch, axis=0) + WIDER
    faces = faces_near(surroundings, np.stack([centre - half, centre + half]))
    upright = np.asarray(surroundings.face_normals)[faces] @ normal
    inner = np.setdiff1d(  # not where walls stand on it, nor where it ends
        np.asarray(surroundings.faces)[faces[upright > MOST_STEEP]],
        np.asarray(surroundings.faces)[faces[upright < OF_AN_EDGE]],
    )
    vertices = np.asarray(surroundings.vertices)[inner]
    wider, level = normal, offset
    for _ in range(REFITS):  # a short patch leans more than its noise at the ends of the longer one
        near = vertices[np.abs(vertices @ wider - level) <= OUTLIER * noise]
        if len(near) < FEW_VERTICES:
            return normal, offset
        middle = near.mean(axis=0)
        wider = np.linalg.svd(near - middle, full_matrices=False)[2][-1]
        wider = wider if wider @ normal > 0 else -wider
        level = float(wider @ middle)
    scatter = float(np.sqrt(np.mean((patch @ wider - level) ** 2)))
    return (wider, level) if scatter <= noise else (normal, offset)


def _outline_area(corners: Float[np.ndarray, "k 3"]) -> float:
    """Return the area of a convex polygon in space [m^2]."""
    if len(corners) < 3:
        return 0.0
    spokes = corners[1:] - corners[0]
    return float(0.5 * np.linalg.norm(np.cross(spokes[:-1], spokes[1:]).sum(axis=0)))
