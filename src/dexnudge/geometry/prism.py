"""Outlines in a plane, and the prisms that stand on them."""

from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float


def smallest_rectangle(
    outline: Float[np.ndarray, "k 2"], directions: Sequence[Float[np.ndarray, "2"]]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """Return corner, sides (longer first) and axes (rows) of a smallest rectangle along `directions`, or an edge."""
    edges = np.array(directions) if directions else np.roll(outline, -1, axis=0) - outline
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    best: tuple[float, np.ndarray, np.ndarray, np.ndarray] | None = None
    for edge in edges:
        axes = np.array([edge, [-edge[1], edge[0]]])
        local = outline @ axes.T
        low, sides = local.min(axis=0), np.ptp(local, axis=0)
        if best is None or sides.prod() < best[0]:
            best = float(sides.prod()), low @ axes, sides, axes
    assert best is not None
    _, corner, sides, axes = best
    return (corner, sides, axes) if sides[0] >= sides[1] else (corner, sides[::-1], axes[::-1])


def outline_area(outline: Float[np.ndarray, "k 2"]) -> float:
    """Return the area of a polygon [m^2]."""
    following = np.roll(outline, -1, axis=0)
    return float(np.abs(np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0])) / 2)


def prism(outline: Float[np.ndarray, "k 2"], height: float) -> trimesh.Trimesh:
    """Return a closed prism over a convex outline [m], from -height / 2 to height / 2."""
    turned = np.sum(outline[:, 0] * np.roll(outline[:, 1], -1) - outline[:, 1] * np.roll(outline[:, 0], -1))
    around = outline if turned > 0 else outline[::-1]
    count = len(around)
    low, high = (np.column_stack([around, np.full(count, z)]) for z in (-height / 2, height / 2))
    here = np.arange(count)
    following = (here + 1) % count
    fan = np.column_stack([np.zeros(count - 2, dtype=int), here[1:-1], here[2:]])
    faces = np.concatenate(
        [
            fan[:, ::-1],
            fan + count,
            np.column_stack([here, following, following + count]),
            np.column_stack([here, following + count, here + count]),
        ]
    )
    return trimesh.Trimesh(np.concatenate([low, high]), faces, process=False)
