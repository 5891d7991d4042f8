"""Planes through measured surfaces: robust against what belongs to no plane, and told from two levels of a step.

Least median of squares (Rousseeuw, 1984), then least squares over what agrees, and over the surface around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.surface_lattice import faces_near

LEAST_POINTS = 12  # of a patch; fewer make no plane
TRIPLES = 300  # of points tried; half of the points may belong to no plane and one of them is good all the same
OUTLIER = 2.5  # standard deviations from which a point is not of the plane
MAD_TO_DEVIATION = 1.4826  # standard deviation of a normal distribution over its median absolute value
EXACT = 2e-5  # [m] residuals below it are rounding of a file with five decimals, and no noise
MOST_LEAN = 5.0  # [deg] between planes that are two levels of one support
LEVELS_SCATTER = 1.2  # times the roughness from vertex to vertex, from which one plane does not fit
LEVELS_FIT = 1.2  # times the same that two levels may scatter
LEVELS_APART = 1.5  # standard deviations between two levels
LEVELS_SHARE = 0.15  # of the vertices that the smaller one has at least
NEIGHBOURS = 6  # of a vertex in a triangle mesh
FEW_VERTICES = 30  # below which the noise is read off the patch itself, not off its vertices
OF_AN_EDGE = 0.3  # cosine with a plane's normal below which a face is of a wall or an edge
REFITS = 6  # of a plane to a wider surface
WIDER = 0.10  # [m] around a patch, where the same surface is looked for
MOST_STEEP = 0.5  # cosine between a support's normal and the direction that it faces
STRAY = 6.0  # standard deviations by which a single measurement may be off, amid others that are not


def fit_plane(
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


def plane_noise(
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
class Level:
    """One of two parallel planes: unit normal, offset [m], noise [m], and the points of the patch that are its own."""

    normal: Float[np.ndarray, "3"]
    offset: float
    noise: float
    points: Float[np.ndarray, "n 3"]


def two_levels(
    surroundings: trimesh.Trimesh,
    face: Int[np.ndarray, " n"],
    points: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "3"],
    scatter: float,
) -> list[Level]:
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
        Level(best, offset, noise, points[own])
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


def refined_plane(
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
