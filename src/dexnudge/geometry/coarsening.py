"""Meshes with fewer triangles: large surroundings, coarse where neither hand nor object comes, and what is only looked at.

Of surroundings what is near stays as it is, triangle by triangle. Vertices beyond are joined by the cells of a grid whose
cells grow with the distance (vertex clustering, Rossignac and Borrel, 1993). Nothing is cut off: joining vertices maps
closed surfaces onto closed ones, so the winding number near the object, and with it inside and outside, is that of the
whole.
"""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

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
    coarse, kept = _coarse(vertices, faces, moved, distance, SMALLEST_CELL)
    coarse.remove_unreferenced_vertices()
    note = (
        f"{len(faces):,} triangles; those more than {1e3 * reach:.0f} mm from the object and its way were joined "
        f"to coarser ones, {len(kept):,} are left"
    )
    coarse.metadata.update(mesh.metadata, notes=[*mesh.metadata.get("notes", ()), note])
    return coarse


def coarsened_faces(
    mesh: trimesh.Trimesh,
    uncertain: Bool[np.ndarray, " f"],
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    *,
    reach: float,
    cell: float,
) -> tuple[trimesh.Trimesh, Int[np.ndarray, " left"]]:
    """Return (a surface with fewer of the faces that are known only roughly, which of the faces each of its own was).

    A closed surface stays closed.

    Args:
        mesh: surface [m]; not changed.
        uncertain: faces that may be joined to coarser ones; all others keep their place.
        low: corner of a box [m].
        high: its other corner [m].
        reach: faces whose bounds come within this of the box keep theirs, too [m].
        cell: edge of the smallest cells whose vertices are joined [m].
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    distance = _distance(vertices, faces, low - reach, high + reach)
    moved = distance > 0
    moved[faces[~uncertain]] = False
    coarse, kept = _coarse(vertices, faces, moved, distance, cell)
    return _parted(np.asarray(coarse.vertices), np.asarray(coarse.faces), kept)


def _coarse(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    moved: Bool[np.ndarray, " v"],
    distance: Float[np.ndarray, " v"],
    cell: float,
) -> tuple[trimesh.Trimesh, Int[np.ndarray, " left"]]:
    """Return (the surface with some vertices joined by cells of `cell` [m] or larger, which faces are left of it)."""
    place, position = _joined(vertices, moved, distance, cell)
    kept, corners = _faces_left(place[faces], moved[faces].any(axis=1))
    return trimesh.Trimesh(position, corners, process=False), kept


def _parted(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], index: Int[np.ndarray, " f"]
) -> tuple[trimesh.Trimesh, Int[np.ndarray, " left"]]:
    """Return (the surface without edges of four faces and vertices of two fans, the index of each of its faces).

    They arise where joined surfaces touch, and would make a closed surface count as open. Two faces that pass an edge in
    opposite directions are neighbours; fans that have no neighbours in common get vertices of their own. Where two pairs
    have both fans in common, one gets a vertex amid the edge.
    """
    while True:
        one, other, rank = _neighbours(faces)
        ends = [np.stack([one, _next(other)]), np.stack([_next(one), other])]
        links = np.concatenate(ends, axis=1)
        graph = coo_array((np.ones(links.shape[1]), links), shape=(faces.size, faces.size))
        count, new = connected_components(graph, directed=False)
        old = np.empty(count, dtype=np.int64)
        old[new] = faces.ravel()
        vertices, faces = vertices[old], new.reshape(-1, 3).astype(np.int64)
        one, other, rank = _neighbours(faces)
        pairs = np.stack([one, other], axis=1)[rank > 0]
        if len(pairs) == 0:
            return trimesh.Trimesh(vertices, faces, process=False), index
        # A face is cut once a round.
        owner = pairs // 3
        first = np.full(len(faces), len(pairs))
        np.minimum.at(first, owner.ravel(), np.repeat(np.arange(len(pairs)), 2))
        pairs = pairs[(first[owner] == np.arange(len(pairs))[:, None]).all(axis=1)]
        start, end = faces.ravel()[pairs[:, 0]], faces.ravel()[_next(pairs[:, 0])]
        middle = len(vertices) + np.arange(len(pairs))
        vertices = np.concatenate([vertices, 0.5 * (vertices[start] + vertices[end])])
        cut, middle = pairs.T.ravel(), np.tile(middle, 2)
        halves = faces[cut // 3]
        halves[np.arange(len(cut)), cut % 3] = middle
        faces.ravel()[_next(cut)] = middle
        faces, index = np.concatenate([faces, halves]), np.concatenate([index, index[cut // 3]])


def _next(corner: Int[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    """Return the next corner of the same face, of corners counted 3 a face."""
    return np.asarray(corner + np.where(corner % 3 == 2, -2, 1))


def _neighbours(
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """Return (a corner before each edge that two faces pass, that of the face the other way, how many pairs came before)."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    down, low, high = start > end, np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((down, high, low))
    begins = np.ones(len(order), dtype=bool)
    for column in (low, high, down):
        begins[1:] &= column[order[1:]] == column[order[:-1]]
    begins[1:] = ~begins[1:]
    first = np.flatnonzero(begins)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - np.repeat(first, np.diff(np.append(first, len(order))))
    order = np.lexsort((down, rank, high, low))
    one, other = order[:-1], order[1:]
    pair = down[other] & ~down[one]
    for column in (low, high, rank):
        pair &= column[one] == column[other]
    return one[pair], other[pair], rank[one[pair]]


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
    vertices: Float[np.ndarray, "v 3"],
    moved: Bool[np.ndarray, " v"],
    distance: Float[np.ndarray, " v"],
    smallest: float,
) -> tuple[Int[np.ndarray, " v"], Float[np.ndarray, "new 3"]]:
    """Return (the new vertex of each vertex, the new vertices): those that stay, then the middles of cells."""
    level = np.floor(np.log2(np.maximum(distance[moved] * CELL_SHARE / smallest, 1.0))).astype(np.int64)
    cell = np.floor(vertices[moved] / (smallest * 2.0**level)[:, None]).astype(np.int64)
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


LARGEST_MESH = 40_000  # triangles; a finer mesh is thinned, so that a page stays below a few megabytes
FIRST_CELL = 1 / 400  # of a mesh's diagonal: cells into which a too fine mesh is thinned
COARSER = 1.25  # by this the cells grow until the mesh is small enough


def thinned(mesh: trimesh.Trimesh, *, most: int = LARGEST_MESH) -> trimesh.Trimesh:
    """Return a mesh of at most so many triangles that looks the same: vertices that share a small cell become one.

    Only for looking at; nothing is ever judged on it.
    """
    result, cell = mesh, float(np.linalg.norm(mesh.extents)) * FIRST_CELL
    while len(result.faces) > most:
        result = trimesh.Trimesh((mesh.vertices - mesh.bounds[0]) / cell, mesh.faces, process=False)
        result.merge_vertices(digits_vertex=0)
        result.update_faces(result.nondegenerate_faces() & result.unique_faces())
        result = trimesh.Trimesh(mesh.bounds[0] + cell * result.vertices, result.faces, process=False)
        cell *= COARSER
    return result
