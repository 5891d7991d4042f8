"""Convex outlines in the plane: hulls, sweeps and the distance between two of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

Outline = Float[np.ndarray, "_ 2"]


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
    """Distance [m] between two convex outlines; negative where they overlap.

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
