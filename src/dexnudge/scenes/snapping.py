"""Measured surroundings with their supports made flat: what scatters about a fitted plane is put onto it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.sparse import coo_array, identity

from dexnudge.scenes.plane_fit import EXACT, STRAY
from dexnudge.scenes.supports import Support

BAND = 4.0  # standard deviations about the plane; beyond it a vertex is no noise
LEVEL = 1.2  # standard deviations of the mean over some twelve vertices: four of its own
UPRIGHT = 0.2  # cosine of a vertex's normal with the plane's from which it belongs to that surface, and not to a wall
ON_PLANE = 1e-7  # [m] a surface this near to its plane is left as it is
AROUND = 1.0  # [m] from the object up to which its supports are followed: a hand reaches less far
LOWEST_TRIANGLE = 1e-5  # [m] a lower one has no direction of its own


def snapped(
    surroundings: trimesh.Trimesh, supports: Sequence[Support], *, around: Float[np.ndarray, "3"]
) -> trimesh.Trimesh:
    """Return surroundings [m, world] whose vertices within the noise of a support lie on its plane.

    Followed up to 1 m `around` a point, over gaps and holes. Surroundings that are flat already are returned as they are.
    """
    vertices = np.array(surroundings.vertices, dtype=np.float64)
    nearest = np.full(len(vertices), np.inf)
    placed = vertices.copy()
    within = np.abs(vertices - around).max(axis=1) <= AROUND
    for support in supports:
        height = support.height(vertices)
        near = within & (np.abs(height) <= STRAY * max(support.noise, EXACT))
        mine = np.flatnonzero(near & _belongs(surroundings, support, height, near))
        mine = mine[np.abs(height[mine]) < nearest[mine]]
        nearest[mine] = np.abs(height[mine])
        placed[mine] = vertices[mine] - height[mine, None] * support.normal
    moved = np.isfinite(nearest)
    if not (nearest[moved] > ON_PLANE).any():
        return surroundings
    faces = np.asarray(surroundings.faces)
    kept = ~(moved[faces].all(axis=1) & (_lowest_height(placed[faces]) < LOWEST_TRIANGLE))
    made = trimesh.Trimesh(placed, faces[kept], process=False)
    made.metadata.update(surroundings.metadata)
    if "origin" in made.metadata:
        made.metadata["origin"] = made.metadata["origin"][kept]
    return made


def _belongs(
    mesh: trimesh.Trimesh, support: Support, height: Float[np.ndarray, " n"], near: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return which vertices are of a support's surface: in its band, turned like it, and on it on average with others.

    A step or a lip has the same few millimetres as the noise, but neighbours have them alike; so what decides is the mean
    height of a vertex and those up to two edges away. Not so in surfaces fused from depth: there the errors of a view are
    alike over centimetres.
    """
    faces = np.asarray(mesh.faces)
    faces = faces[near[faces].any(axis=1)]
    used, corner = np.unique(faces, return_inverse=True)
    corner, count = corner.reshape(-1, 3), len(used)
    corners = np.asarray(mesh.vertices)[faces]
    lean = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack([np.bincount(corner.ravel(), np.repeat(axis, 3), count) for axis in lean.T], axis=1)
    along = total @ support.normal
    noise = max(support.noise, EXACT)
    own, inside = height[used], near[used]
    alike = inside & (along > UPRIGHT * np.linalg.norm(total, axis=1))
    pairs = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    links = coo_array((np.ones(2 * len(pairs)), (pairs.ravel("F"), pairs[:, ::-1].ravel("F"))), shape=(count, count))
    links = links.tocsr() + identity(count, format="csr")
    mean = own
    for _ in range(2):
        mean = (links @ (alike * mean)) / np.maximum(links @ alike.astype(float), 1.0)
    level = np.abs(mean) <= (BAND if "origin" in mesh.metadata else LEVEL) * noise
    belongs = alike & level & (np.abs(own) <= BAND * noise)
    for _ in range(2):  # stray vertices, and such that noise has turned, amid others that belong
        among, others = links @ belongs.astype(float) - belongs, links @ np.ones(count) - 1.0
        belongs |= inside & (others > 0) & (among == others)
        belongs |= inside & level & (np.abs(own) <= BAND * noise) & (among > 0.5 * others) & (along > 0)
    found = np.zeros(len(height), dtype=bool)
    found[used] = belongs
    return found & near


def _lowest_height(corners: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, " face"]:
    """Return each triangle's height over its longest side [m]."""
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.divide(twice_area, longest, out=np.zeros(len(corners)), where=longest > 0)
