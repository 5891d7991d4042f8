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
MOST_LEAN = 5.0  # [deg] between planes that are two levels of one support
LEVELS_SCATTER = 1.2  # times the roughness from vertex to vertex, from which one plane does not fit
LEVELS_FIT = 1.2  # times the same that two levels may scatter
LEVELS_APART = 1.5  # standard deviations between two levels
LEVELS_SHARE = 0.15  # of the vertices that the smaller one has at least
NEIGHBOURS = 6  # of a vertex in a triangle mesh
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
        normal, offset, mine = _plane(points[left], -direction)
        if np.count_nonzero(mine) < max(LEAST_POINTS, LEAST_SHARE * len(points)):
            break
        if normal @ -direction > MOST_STEEP:
            on_plane = points[left[mine]]
            measured = _noise(on_plane, surroundings, face[left[mine]], normal, offset)
            if not found and (levels := _two_levels(surroundings, face, points, normal, measured)):
                for level in levels:
                    corners = level.points[hull_corners(level.points, level.normal, tolerance=CORNER_TOLERANCE)]
                    area = _outline_area(corners)
                    found.append(Support(level.normal, level.offset, level.noise, area, corners, side))
                break
            normal, offset = _refined(surroundings, on_plane, normal, offset, measured)
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


@dataclass(frozen=True)
class _Level:
    """One of two parallel planes: unit normal, offset [m], noise [m], and the points of the patch that are its own."""

    normal: Float[np.ndarray, "3"]
    offset: float
    noise: float
    points: Float[np.ndarray, "n 3"]


def _two_levels(
    surroundings: trimesh.Trimesh,
    face: Int[np.ndarray, " n"],
    points: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "3"],
    scatter: float,
) -> list[_Level]:
    """Return two parallel planes where one fits worse than the surface is rough from vertex to vertex; else nothing.

    A plane across a step of some millimetres leans and scatters a little more than either side of it. Of planes about as
    steep as it, that direction is taken in which the vertices' heights fall best into two groups.
    """
    faces = np.asarray(surroundings.faces)[np.unique(face)]
    vertices, corner = np.unique(faces, return_inverse=True)
    corner, vertices = corner.reshape(-1, 3), np.asarray(surroundings.vertices)[vertices]
    rough = _roughness(vertices @ normal, corner)
    if len(vertices) < 2 * FEW_VERTICES or rough <= EXACT or scatter < LEVELS_SCATTER * rough:
        return []
    triples = vertices[np.random.default_rng(0).integers(len(vertices), size=(TRIPLES, 3))]
    lean = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lean /= np.maximum(np.linalg.norm(lean, axis=1, keepdims=True), 1e-12)
    lean *= np.sign(lean @ normal)[:, None]
    lean = np.concatenate([normal[None], lean[lean @ normal > np.cos(np.radians(MOST_LEAN))]])
    heights = np.sort(vertices @ lean.T, axis=0)
    best = lean[int(np.argmin([_split(column)[0] for column in heights.T]))]
    upper = vertices @ best > _split(np.sort(vertices @ best))[1]
    for _ in range(REFITS):
        groups = [vertices[upper], vertices[~upper]]
        if min(map(len, groups)) < LEVELS_SHARE * len(vertices):
            return []
        about = np.concatenate([group - group.mean(axis=0) for group in groups])
        best = np.linalg.svd(about, full_matrices=False)[2][-1]
        best = best if best @ normal > 0 else -best
        offsets = [float(group.mean(axis=0) @ best) for group in groups]
        upper = vertices @ best > 0.5 * sum(offsets)
    noise = float(np.sqrt(np.mean((about @ best) ** 2)))
    if noise > LEVELS_FIT * rough or offsets[0] - offsets[1] < LEVELS_APART * noise:
        return []
    high = points @ best > 0.5 * sum(offsets)
    return [
        _Level(best, offset, noise, points[own])
        for offset, own in zip(offsets, (high, ~high), strict=True)
        if np.count_nonzero(own) >= LEAST_POINTS
    ]


def _roughness(height: Float[np.ndarray, " vertex"], corner: Int[np.ndarray, "face 3"]) -> float:
    """Return the noise of vertices [m] by how far each is off the mean of its neighbours."""
    total, count = np.zeros(len(height)), np.zeros(len(height))
    for one, other in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
        np.add.at(total, corner[:, one], height[corner[:, other]])
        np.add.at(count, corner[:, one], 1.0)
    off = height - total / np.maximum(count, 1.0)
    return MAD_TO_DEVIATION * float(np.median(np.abs(off))) / float(np.sqrt(1.0 + 1.0 / NEIGHBOURS))


def _split(height: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return (squared error [m^2], height between them [m]) of the best two groups of sorted heights."""
    centred = height - height.mean()
    count = np.arange(1, len(height))
    left = np.cumsum(centred)[:-1]
    gain = left**2 / count + left**2 / (len(height) - count)
    at = int(np.argmax(gain))
    return float((centred**2).sum() - gain[at]), 0.5 * float(height[at] + height[at + 1])


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
