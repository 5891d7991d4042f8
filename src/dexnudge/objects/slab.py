"""A closed body with a rounded outline, rounded edges, and height fields for its two faces.

The two faces are grids that follow the outline (rows at stations along x, columns at fractions of the half width);
the side joins their borders through rings. So every triangle comes from a quadrilateral of a regular grid, and the
body is closed by construction, whatever the heights are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from jaxtyping import Float, Int

Heights = Callable[[Float[np.ndarray, "u v"], Float[np.ndarray, "u v"]], Float[np.ndarray, "u v"]]
Profile = Callable[[Float[np.ndarray, " u"]], Float[np.ndarray, " u"]]

CORNER_STATIONS = 5  # rows of the grid over each rounded end
EDGE_RINGS = 3  # rings over each rounded edge
ROUND = 0.5  # of the thickness here: two roundings that meet
FLATTEST_SIDE = 0.45  # of the thickness here: the highest rounding that leaves a side
LEDGE = 0.05  # of the height of a recess: the drop of its ledges


def level(x: Float[np.ndarray, "..."], _y: object) -> Float[np.ndarray, "..."]:
    """A flat face."""
    return np.zeros_like(x)


def straight(x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " u"]:
    """An outline as wide everywhere."""
    return np.ones_like(x)


@dataclass(frozen=True)
class SlabShape:
    """What `slab_mesh` builds; lengths in metres, x and y as fractions of half the length and half the width.

    Attributes:
        size: (length, width, thickness), exactly the bounding box of the result, along x, y and z.
        corner: radius of the outline's corners along the width, as a fraction of half the width, below 1.
        corner_length: the same along the length, as a fraction of half the width.
        edge: radius of the edges, as a fraction of half the thickness, at most 1.
        width_at: fraction of the width at x in -1..1.
        top, bottom: displacement of the faces along +z [m] at (x, y), before the body is fitted to `size`.
        rows, columns: positions in -1..1 at which the grid must have a line, for steps in `top` or `bottom`.
        cells: how many cells each face has along x, without its rounded ends, and along y.
        recess: how far the middle of the side is set in [m], at the outline's points where `recess_at` (x, y) is 1.
    """

    size: tuple[float, float, float]
    corner: float = 0.3
    corner_length: float = 0.3
    edge: float = 0.5
    width_at: Profile = straight
    top: Heights = level
    bottom: Heights = level
    rows: tuple[float, ...] = ()
    columns: tuple[float, ...] = ()
    cells: tuple[int, int] = (22, 10)
    recess: float = 0.0
    recess_at: Heights = level


def slab_mesh(shape: SlabShape) -> trimesh.Trimesh:
    """Closed mesh of `shape`, centred on its bounding box; x = length, y = width, z = thickness."""
    length, width, thickness = shape.size
    edge = 0.5 * thickness * shape.edge
    half_length, half_width = length / 2 - edge, width / 2 - edge
    stations = _stations(shape, half_length, half_width)
    fractions = _lines(np.linspace(-1, 1, shape.cells[1] + 1), shape.columns)
    half = _half_width(shape, stations, half_length, half_width)
    x = np.repeat((stations * half_length)[:, None], len(fractions), axis=1)
    y = half[:, None] * fractions
    u, v = x / half_length, y / half_width
    top, bottom = thickness / 2 + shape.top(u, v), -thickness / 2 + shape.bottom(u, v)
    border = _border(*x.shape)
    rings = _side_rings(shape, x, y, top, bottom, border, edge, (half_length, half_width))
    vertices = np.concatenate([np.stack([x, y, z], -1).reshape(-1, 3) for z in (top, bottom)] + rings)
    faces = _faces(x.shape, border, len(rings), x, y)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2) * (np.array(shape.size) / (high - low))
    return trimesh.Trimesh(vertices, faces, process=False)


def _lines(regular: Float[np.ndarray, " n"], wanted: tuple[float, ...]) -> Float[np.ndarray, " m"]:
    """The regular lines and the wanted ones, without regular ones that crowd a wanted one; the ends stay."""
    if not wanted:
        return regular
    extra = np.array(wanted)
    spacing = 0.45 * float(np.diff(regular).max())
    keep = np.abs(regular[:, None] - extra).min(axis=1) > spacing
    keep[[0, -1]] = True
    return np.unique(np.concatenate([regular[keep], extra]))


def _stations(shape: SlabShape, half_length: float, half_width: float) -> Float[np.ndarray, " n"]:
    """Rows along x in -1..1: even in the middle, by angle over the rounded ends."""
    reach = min(shape.corner_length * half_width / half_length, 0.9)
    angles = np.linspace(0, np.pi / 2, CORNER_STATIONS + 1)
    end = 1 - reach + reach * np.cos(angles) if shape.corner > 0 else np.array([1.0])
    inner = np.linspace(-end.min(), end.min(), shape.cells[0] + 1)
    inner = _lines(inner, tuple(row for row in shape.rows if abs(row) < end.min()))
    return np.unique(np.round(np.concatenate([-end, inner, end]), 12))


def _half_width(
    shape: SlabShape, stations: Float[np.ndarray, " n"], half_length: float, half_width: float
) -> Float[np.ndarray, " n"]:
    """Half width [m] of the outline at the rows: the profile, less the elliptic corners."""
    profile = half_width * shape.width_at(stations)
    if shape.corner <= 0:
        return profile
    reach = min(shape.corner_length * half_width / half_length, 0.9)
    into = np.clip((np.abs(stations) - (1 - reach)) / reach, 0, 1)
    return profile * (1 - shape.corner * (1 - np.sqrt(1 - into**2)))


def _border(rows: int, columns: int) -> Int[np.ndarray, " k"]:
    """Flat indices of the border of a grid, counter-clockwise seen from +z (row = x, column = y)."""
    index = np.arange(rows * columns).reshape(rows, columns)
    return np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])


def _side_rings(
    shape: SlabShape,
    x: Float[np.ndarray, "u v"],
    y: Float[np.ndarray, "u v"],
    top: Float[np.ndarray, "u v"],
    bottom: Float[np.ndarray, "u v"],
    border: Int[np.ndarray, " k"],
    edge: float,
    half: tuple[float, float],
) -> list[Float[np.ndarray, "k 3"]]:
    """Loops of points from the top face's border (exclusive) over the side to the bottom face's (exclusive)."""
    outline = np.stack([x, y], -1).reshape(-1, 2)[border]
    ahead, behind = np.roll(outline, -1, axis=0) - outline, outline - np.roll(outline, 1, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    behind /= np.linalg.norm(behind, axis=1, keepdims=True)
    tangent = ahead + behind
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], -1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    high, low = top.ravel()[border], bottom.ravel()[border]
    # Where the body is thinner than its roundings, these flatten, and a side is left between them.
    drop = np.minimum(edge, (ROUND if shape.edge >= 1 else FLATTEST_SIDE) * (high - low))
    angles = np.linspace(0, np.pi / 2, EDGE_RINGS + 1)[1:]
    levels = [(edge * np.sin(a), high - drop * (1 - np.cos(a))) for a in angles]
    under = [(edge * np.sin(a), low + drop * (1 - np.cos(a))) for a in angles[::-1]]
    if shape.recess > 0:
        inset = edge - shape.recess * shape.recess_at(outline[:, 0] / half[0], outline[:, 1] / half[1])
        cover = 0.12 * (high - low)
        upper, lower = high - drop - cover, low + drop + cover
        out = np.full_like(high, edge)
        # The ledges slope, so that no triangle vanishes where the side is not set in.
        slope = LEDGE * (upper - lower)
        levels += [
            (out, upper),
            (inset, upper - slope),
            (inset, (upper + lower) / 2),
            (inset, lower + slope),
            (out, lower),
        ]
    elif shape.edge < 1:
        levels.append((edge, (high + low) / 2))
    else:
        under = under[1:]
    return [
        np.column_stack([outline + normal * np.reshape(offset, (-1, 1)), height]) for offset, height in levels + under
    ]


def _faces(
    grid: tuple[int, int],
    border: Int[np.ndarray, " k"],
    rings: int,
    x: Float[np.ndarray, "u v"],
    y: Float[np.ndarray, "u v"],
) -> Int[np.ndarray, "f 3"]:
    """Triangles of the top grid, the bottom grid (wound the other way) and the loops between them."""
    rows, columns = grid
    count = rows * columns
    index = np.arange(count).reshape(grid)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    # The shorter diagonal of each cell, so that triangles at the rounded corners stay well shaped.
    ac = (x[1:, 1:] - x[:-1, :-1]) ** 2 + (y[1:, 1:] - y[:-1, :-1]) ** 2
    bd = (x[1:, :-1] - x[:-1, 1:]) ** 2 + (y[1:, :-1] - y[:-1, 1:]) ** 2
    short = (ac <= bd)[..., None]
    first = np.where(short, np.stack([a, b, c], -1), np.stack([a, b, d], -1)).reshape(-1, 3)
    second = np.where(short, np.stack([a, c, d], -1), np.stack([b, c, d], -1)).reshape(-1, 3)
    face = np.concatenate([first, second])
    size = len(border)
    loops = [border, *(2 * count + k * size + np.arange(size) for k in range(rings)), border + count]
    sides = []
    for upper, lower in pairwise(loops):
        following, below = np.roll(upper, -1), np.roll(lower, -1)
        sides += [np.stack([upper, lower, below], -1), np.stack([upper, below, following], -1)]
    return np.concatenate([face, face[:, ::-1] + count, *sides])
