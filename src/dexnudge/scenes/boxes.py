"""What scenes are built of: boxes and poses in space, convex outlines in the plane and the gap between two of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull

# Corner k has the upper bound of axis a where bit a of k is set.
_CORNERS = np.array([[(k >> a) & 1 for a in range(3)] for k in range(8)])
_FACES = np.array(
    [
        [0, 2, 3], [0, 3, 1],  # z low
        [4, 5, 7], [4, 7, 6],  # z high
        [0, 1, 5], [0, 5, 4],  # y low
        [2, 6, 7], [2, 7, 3],  # y high
        [0, 4, 6], [0, 6, 2],  # x low
        [1, 3, 7], [1, 7, 5],  # x high
    ]
)  # fmt: skip


Outline = Float[np.ndarray, "_ 2"]


def box(low: Sequence[float], high: Sequence[float], *, yaw: float = 0.0) -> trimesh.Trimesh:
    """Closed box from corner `low` to corner `high` [m], turned by `yaw` [rad] about the vertical through its centre."""
    low_corner, high_corner = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    vertices = low_corner + _CORNERS * (high_corner - low_corner)
    if yaw:
        centre = (low_corner + high_corner) / 2
        vertices = (vertices - centre) @ turn(yaw)[:3, :3].T + centre
    return trimesh.Trimesh(vertices, _FACES, process=False)


def joined(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several bodies, in order, each still closed by itself."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return trimesh.Trimesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        process=False,
    )


def turn(yaw: float) -> Float[np.ndarray, "4 4"]:
    """Rotation by `yaw` [rad] about +z."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def shift(x: float, y: float, z: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """Translation [m]."""
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def outline_of(points: Float[np.ndarray, "_ 2"]) -> Outline:
    """Convex hull of points in the plane, counter-clockwise."""
    return np.asarray(points)[ConvexHull(points).vertices]


def rectangle(centre: Float[np.ndarray, "2"], size: tuple[float, float], yaw: float) -> Outline:
    """Rectangle of `size` [m] turned by `yaw` [rad], counter-clockwise."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.asarray(size) / 2
    c, s = np.cos(yaw), np.sin(yaw)
    return corners @ np.array([[c, s], [-s, c]]) + centre


def swept(outline: Outline, displacement: Float[np.ndarray, "2"]) -> Outline:
    """What a convex outline covers while it moves straight by `displacement` [m]."""
    return outline_of(np.concatenate([outline, outline + displacement]))


def gap_between(first: Outline, second: Outline) -> float:
    """Return the distance [m] between two convex outlines; negative where they overlap.

    Apart: the nearest pair is a vertex and an edge. Overlapping: minus the least shift along an edge's normal that
    parts them.
    """
    separation = max(_largest_separation(first, second), _largest_separation(second, first))
    if separation <= 0:
        return separation
    return min(_vertex_to_edge(first, second), _vertex_to_edge(second, first))


def _largest_separation(first: Outline, second: Outline) -> float:
    edges = np.roll(first, -1, axis=0) - first
    normals = np.stack([edges[:, 1], -edges[:, 0]], -1) / np.linalg.norm(edges, axis=1, keepdims=True)
    return float(np.max((second @ normals.T).min(axis=0) - np.einsum("ij,ij->i", first, normals)))


def _vertex_to_edge(vertices: Outline, outline: Outline) -> float:
    edges = np.roll(outline, -1, axis=0) - outline
    offset = vertices[:, None] - outline
    along = np.clip(np.einsum("vej,ej->ve", offset, edges) / np.einsum("ej,ej->e", edges, edges), 0, 1)
    return float(np.linalg.norm(offset - along[..., None] * edges, axis=-1).min())
