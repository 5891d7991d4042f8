"""Regular points on triangles: on a square lattice inside each, and along its edges, corners included; faces near a box.

Unlike random points these need no search, are the same for any part of a surface that one asks for, and hold every
corner and edge of the mesh, where one body reaches deepest into another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float, Int, Num


def distinct_rows(rows: Num[np.ndarray, "n column"]) -> tuple[Int[np.ndarray, " distinct"], Int[np.ndarray, " n"]]:
    """Return (index of the first of each distinct row, in ascending order of rows; which of these each row equals).

    The same as `return_index` and `return_inverse` of `numpy.unique(rows, axis=0)`, which compares whole rows as one
    record. `rows` holds no NaN and at least one column.
    """
    columns = [np.ascontiguousarray(column) for column in rows.T]
    if (key := _one_number(columns)) is not None:
        columns = [key]
    order = np.lexsort(columns[::-1])
    begins = np.ones(len(rows), dtype=bool)
    begins[1:] = np.any([column[order[1:]] != column[order[:-1]] for column in columns], axis=0)
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = np.cumsum(begins) - 1
    return order[begins], place


def _one_number(columns: Sequence[Num[np.ndarray, " n"]]) -> Int[np.ndarray, " n"] | None:
    """Return a number for each row of whole numbers, ordered as the rows are; None where it would not fit 63 bits."""
    key = np.zeros(len(columns[0]), dtype=np.int64)
    if not len(key):
        return key
    low, high = [column.min() for column in columns], [column.max() for column in columns]
    counts = [float(most) - float(least) + 1 for most, least in zip(high, low, strict=True)]
    exact = max(map(abs, map(float, (*low, *high)))) < LARGEST_WHOLE and np.prod(counts) < LARGEST_KEY
    if not exact or any((column != np.rint(column)).any() for column in columns):
        return None
    for column, least, count in zip(columns, low, counts, strict=True):
        key = key * int(count) + (column - least).astype(np.int64)
    return key


LARGEST_WHOLE = 2.0**53  # up to which a float64 holds every whole number
LARGEST_KEY = 2.0**62  # of `_one_number`: below the largest integer, whatever rounding does to the product
PAIRS_AT_ONCE = 2_000_000  # (box, triangle) comparisons made in one array, to bound memory


@dataclass(frozen=True)
class Boxes:
    """Oriented boxes [m]: `axes` holds each box's unit axes as rows, `half` the half extents along them."""

    centre: Float[np.ndarray, "box 3"]
    axes: Float[np.ndarray, "box 3 3"]
    half: Float[np.ndarray, "box 3"]


def surface_lattice(
    triangles: Float[np.ndarray, "face 3 3"], *, spacing: float
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Return points on all triangles and the triangle of each; neighbours at most `spacing` [m] apart.

    Edges and corners are there once for each triangle that has them.
    """
    faces = np.arange(len(triangles))
    everywhere = np.full((len(triangles), 2), np.inf)
    inner, inner_face = _inside(triangles, faces, -everywhere, everywhere, spacing)
    whole = np.broadcast_to([0.0, 1.0], (len(triangles), 3, 2))
    edge, edge_face = _along_edges(triangles, faces, whole, spacing)
    return np.concatenate([inner, edge]), np.concatenate([inner_face, edge_face])


def lattice_in_boxes(
    triangles: Float[np.ndarray, "face 3 3"], boxes: Boxes, *, spacing: float
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the points of `surface_lattice` in a box, box and triangle of each; a point in two boxes is there twice."""
    box, face = _touching_pairs(triangles, boxes)
    corners = triangles[face]
    origin, plane = _plane_axes(corners)
    to_centre = boxes.centre[box] - origin
    middle = np.einsum("pkx,px->pk", plane, to_centre)
    reach = np.einsum("pi,pki->pk", boxes.half[box], np.abs(np.einsum("pix,pkx->pki", boxes.axes[box], plane)))
    inner, inner_pair = _inside(corners, np.arange(len(corners)), middle - reach, middle + reach, spacing)
    local = np.einsum("pix,pcx->pci", boxes.axes[box], corners - boxes.centre[box][:, None])
    edge, edge_pair = _along_edges(corners, np.arange(len(corners)), _clip_edges(local, boxes.half[box]), spacing)
    points, pair = np.concatenate([inner, edge]), np.concatenate([inner_pair, edge_pair])
    owner = box[pair]
    in_box = np.einsum("nix,nx->ni", boxes.axes[owner], points - boxes.centre[owner])
    kept = np.all(np.abs(in_box) <= boxes.half[owner], axis=1)
    return points[kept], owner[kept], face[pair[kept]]


def _touching_pairs(
    triangles: Float[np.ndarray, "face 3 3"], boxes: Boxes
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """(box, triangle) pairs that no axis of the world, of the box, nor the triangle's normal separates."""
    empty = np.zeros(0, dtype=np.int64)
    if len(boxes.centre) == 0 or len(triangles) == 0:
        return empty, empty
    reach = np.einsum("bi,bix->bx", boxes.half, np.abs(boxes.axes))
    low, high = boxes.centre - reach, boxes.centre + reach
    face_low, face_high = triangles.min(axis=1), triangles.max(axis=1)
    near = np.flatnonzero(np.all((face_low <= high.max(axis=0)) & (face_high >= low.min(axis=0)), axis=1))
    found = [(empty, empty)]
    step = max(1, PAIRS_AT_ONCE // max(1, len(near)))
    for first in range(0, len(low), step):
        rows = slice(first, first + step)
        overlap = np.ones((len(low[rows]), len(near)), dtype=bool)
        for axis in range(3):
            overlap &= face_low[None, near, axis] <= high[rows, None, axis]
            overlap &= face_high[None, near, axis] >= low[rows, None, axis]
        pairs = np.nonzero(overlap)
        found.append((pairs[0] + first, near[pairs[1]]))
    box = np.concatenate([pair[0] for pair in found])
    face = np.concatenate([pair[1] for pair in found])
    local = np.einsum("pix,pcx->pci", boxes.axes[box], triangles[face] - boxes.centre[box][:, None])
    half = boxes.half[box]
    normal = np.cross(local[:, 1] - local[:, 0], local[:, 2] - local[:, 0])
    offset = np.abs(np.einsum("pi,pi->p", normal, local[:, 0]))
    kept = np.all((local.min(axis=1) <= half) & (local.max(axis=1) >= -half), axis=1)
    kept &= offset <= np.einsum("pi,pi->p", np.abs(normal), half) * (1 + 1e-9)
    return box[kept], face[kept]


def _plane_axes(
    corners: Float[np.ndarray, "face 3 3"],
) -> tuple[Float[np.ndarray, "face 3"], Float[np.ndarray, "face 2 3"]]:
    """First corner, and two unit axes in the triangle's plane, one along its first edge; zeros where it has no area."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    axes = np.stack([first, np.cross(normal, first)], axis=1)
    length = np.linalg.norm(axes, axis=2, keepdims=True)
    return corners[:, 0], np.divide(axes, length, out=np.zeros_like(axes), where=length > 0)


def in_own_planes(corners: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, "face 3 2"]:
    """Corners of triangles in their own planes: about the first corner, the first axis along the first edge."""
    return _in_planes(corners, *_plane_axes(corners))


def _in_planes(
    corners: Float[np.ndarray, "face 3 3"], origin: Float[np.ndarray, "face 3"], plane: Float[np.ndarray, "face 2 3"]
) -> Float[np.ndarray, "face 3 2"]:
    return np.einsum("fkx,fcx->fck", plane, corners - origin[:, None])


def _inside(
    corners: Float[np.ndarray, "face 3 3"],
    label: Int[np.ndarray, " face"],
    low: Float[np.ndarray, "face 2"],
    high: Float[np.ndarray, "face 2"],
    spacing: float,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Lattice points in the triangles' own planes, within [low, high] there."""
    origin, plane = _plane_axes(corners)
    flat = _in_planes(corners, origin, plane)
    first = np.ceil(np.maximum(flat.min(axis=1), low) / spacing).astype(np.int64)
    last = np.floor(np.minimum(flat.max(axis=1), high) / spacing).astype(np.int64)
    count = np.maximum(last - first + 1, 0)
    side = np.roll(flat, -1, axis=1) - flat
    flipped = _cross(side[:, 0], -side[:, 2]) <= 0
    face, place = ragged(np.where(flipped, 0, count[:, 0] * count[:, 1]))
    column, row = np.divmod(place, np.maximum(count[face, 1], 1))
    x, y = spacing * (first[:, 0][face] + column), spacing * (first[:, 1][face] + row)
    kept = np.ones(len(face), dtype=bool)
    for corner in range(3):  # left of each side
        along, across = side[:, corner, 0][face], side[:, corner, 1][face]
        kept &= along * (y - flat[:, corner, 1][face]) - across * (x - flat[:, corner, 0][face]) >= 0
    face, position = face[kept], np.stack([x[kept], y[kept]], axis=1)
    return origin[face] + np.einsum("nk,nkx->nx", position, plane[face]), label[face]


def _along_edges(
    corners: Float[np.ndarray, "face 3 3"],
    label: Int[np.ndarray, " face"],
    span: Float[np.ndarray, "face 3 2"],
    spacing: float,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Points that divide each edge evenly, both ends among them, within the part `span` of it (0 start, 1 end)."""
    start = corners.reshape(-1, 3)
    along = np.roll(corners, -1, axis=1).reshape(-1, 3) - start
    parts = np.maximum(np.ceil(np.linalg.norm(along, axis=1) / spacing), 1.0)
    limits = span.reshape(-1, 2)
    first = np.ceil(limits[:, 0] * parts - 1e-9).astype(np.int64)
    last = np.floor(limits[:, 1] * parts + 1e-9).astype(np.int64)
    edge, place = ragged(np.maximum(last - first + 1, 0))
    share = (first[edge] + place) / parts[edge]
    return start[edge] + share[:, None] * along[edge], np.repeat(label, 3)[edge]


def _clip_edges(
    local: Float[np.ndarray, "pair 3 3"], half: Float[np.ndarray, "pair 3"]
) -> Float[np.ndarray, "pair 3 2"]:
    """Part of each edge inside the box, in box coordinates; an empty part ends before it starts."""
    along = np.roll(local, -1, axis=1) - local
    slope = np.where(np.abs(along) < 1e-12, 1e-12, along)
    one, other = (-half[:, None] - local) / slope, (half[:, None] - local) / slope
    enter = np.maximum(np.minimum(one, other).max(axis=2), 0.0)
    leave = np.minimum(np.maximum(one, other).min(axis=2), 1.0)
    return np.stack([enter, np.maximum(leave, enter - 1.0)], axis=2)


def ragged(count: Int[np.ndarray, " row"]) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the row and place within it of every item, for rows of `count` items."""
    row = np.repeat(np.arange(len(count)), count)
    return row, np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)


def _cross(one: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]


def faces_near(mesh: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> Int[np.ndarray, " near"]:
    """Return the faces of a mesh whose boxes touch the given bounds [m]; few operations for each vertex of a large mesh."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    near = np.arange(len(faces))
    for axis in range(3):
        for outside in (vertices[:, axis] < bounds[0, axis], vertices[:, axis] > bounds[1, axis]):
            near = near[~outside[faces[near]].all(axis=1)]
    return near
