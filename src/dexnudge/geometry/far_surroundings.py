"""Large surroundings, made coarse where neither hand nor object comes: what is near stays as it is, triangle by triangle.

Vertices beyond are joined by the cells of a grid whose cells grow with the distance (vertex clustering, Rossignac and
Borrel, 1993). Nothing is cut off: joining vertices maps closed surfaces onto closed ones, so the winding number near the
object, and with it inside and outside, is that of the whole.
"""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.surface_lattice import distinct_rows

LARGE = 200_000  # faces; fewer are fast enough as they are
REACH = 0.75  # [m] around the object and its way that stays exact: a hand with its forearm, and room for its approach
CELL_SHARE = 1 / 8  # of its distance from there, the largest edge of a cell: a face moves by at most a quarter of it
SMALLEST_CELL = 0.005  # [m] a scan has no vertices closer together than some millimetres


def coarsened_far(
    mesh: trimesh.Trimesh, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], *, reach: float = REACH
) -> trimesh.Trimesh:
    """Return surroundings of many triangles with fewer of them beyond `reach` [m] of a box; smaller ones as they are.

    Args:
        mesh: surroundings [m]; not changed. More than 200,000 triangles, or it is returned itself.
        low: corner of the box that holds the object and its way [m], in the mesh's frame.
        high: its other corner [m].
        reach: faces whose bounds come within this of the box keep every bit [m].
    """
    if len(mesh.faces) <= LARGE:
        return mesh
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    distance = _distance(vertices, faces, low - reach, high + reach)
    moved = distance * CELL_SHARE >= SMALLEST_CELL
    if not moved.any():
        return mesh
    place, position = _joined(vertices, moved, distance)
    kept, corners = _faces_left(place[faces], moved[faces].any(axis=1))
    coarse = trimesh.Trimesh(position, corners, process=False)
    coarse.remove_unreferenced_vertices()
    note = (
        f"{len(faces):,} triangles; those more than {1e3 * reach:.0f} mm from the object and its way were joined "
        f"to coarser ones, {len(kept):,} are left"
    )
    coarse.metadata.update(mesh.metadata, notes=[*mesh.metadata.get("notes", ()), note])
    return coarse


def _distance(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], low: np.ndarray, high: np.ndarray
) -> Float[np.ndarray, " v"]:
    """Return the least distance [m] of the bounds of each vertex's faces from a box: the largest of the three axes."""
    far = np.zeros(len(faces))
    for axis in range(3):
        one, two, three = (vertices[faces[:, corner], axis] for corner in range(3))
        far = np.maximum(far, np.minimum(np.minimum(one, two), three) - high[axis])
        far = np.maximum(far, low[axis] - np.maximum(np.maximum(one, two), three))
    distance = np.full(len(vertices), np.inf)
    for corner in range(3):
        np.minimum.at(distance, faces[:, corner], far)
    return np.where(np.isfinite(distance), distance, 0.0)


def _joined(
    vertices: Float[np.ndarray, "v 3"], moved: Bool[np.ndarray, " v"], distance: Float[np.ndarray, " v"]
) -> tuple[Int[np.ndarray, " v"], Float[np.ndarray, "new 3"]]:
    """Return (the new vertex of each vertex, the new vertices): those that stay, then the middles of cells."""
    level = np.floor(np.log2(distance[moved] * CELL_SHARE / SMALLEST_CELL)).astype(np.int64)
    cell = np.floor(vertices[moved] / (SMALLEST_CELL * 2.0**level)[:, None]).astype(np.int64)
    first, group = distinct_rows(np.column_stack([level, cell]))
    count = np.bincount(group)
    middle = np.stack([np.bincount(group, column) / count for column in vertices[moved].T], axis=1)
    alone = count == 1
    middle[alone] = vertices[moved][first[alone]]
    stay = np.count_nonzero(~moved)
    place = np.empty(len(vertices), dtype=np.int64)
    place[~moved] = np.arange(stay)
    place[moved] = stay + group
    return place, np.concatenate([vertices[~moved], middle])


def _faces_left(
    corners: Int[np.ndarray, "f 3"], moved: Bool[np.ndarray, " f"]
) -> tuple[Int[np.ndarray, " left"], Int[np.ndarray, "left 3"]]:
    """Return (which faces are left, their corners): not those without area, nor pairs that face each other.

    Of moved faces with the same corners as many remain as face one way more than the other, so that the surface winds around
    every point as before.
    """
    index = np.flatnonzero(
        ~moved
        | ((corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0]))
    )
    joined = index[moved[index]]
    order = np.argsort(corners[joined], axis=1)
    even = (order[:, 1] - order[:, 0]) % 3 == 1  # a rotation of ascending order
    first, group = distinct_rows(np.sort(corners[joined], axis=1))
    net = np.bincount(group, np.where(even, 1, -1), minlength=len(first)).astype(np.int64)
    # The first so many of each group that face the way of the majority.
    wanted = even == (net > 0)[group]
    by_group = np.lexsort((~wanted, group))
    rank = np.empty(len(joined), dtype=np.int64)
    size = np.bincount(group, minlength=len(first))
    rank[by_group] = np.arange(len(joined)) - np.repeat(np.cumsum(size) - size, size)
    gone = joined[(rank >= np.abs(net)[group])]
    keep = np.zeros(len(corners), dtype=bool)
    keep[index] = True
    keep[gone] = False
    left = np.flatnonzero(keep)
    return left, corners[left]
