"""Support contacts on one plane act through the corners of their convex hull; the rest can go."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from dexnudge.geometry.surface_lattice import distinct_rows

NORMAL_STEP = 1e-3
"""Normals and plane offsets over half_length that round to the same multiple of this are one plane [-]."""
COARSE_NORMAL_STEP = 0.1
"""The same for surroundings so rough that single planes leave too many points [-]."""
MANY_SUPPORTS = 96
"""Number of points from which the coarse step is used; the balance's cost grows with it."""
HULL_TOLERANCE = 5e-4
"""A corner that stands out this little over its neighbours' chord, over half_length, is left out [-]."""
TURNING_TOLERANCE = 0.05
"""The same where the object turns on the plane: nothing says that what bulges a little carries it, near the axis and with
little friction, rather than the corners [-]."""
MAX_CORNERS = 32
"""Corners kept per plane: a circle loses 0.5 % of its radius."""
DIRECTIONS = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)])
"""In which the farthest points are looked for, counter-clockwise; unit."""
INSIDE = 1e-9
"""A point at least this deep within a polygon of others is no corner, whatever rounding does [m]."""

_Points = Float[np.ndarray, "point 3"]
_Kept = Float[np.ndarray, "kept 3"]


def reduce_supports(
    points: _Points, normals: _Points, *, half_length: float, tolerance: float = HULL_TOLERANCE
) -> tuple[_Kept, _Kept]:
    """Return the points [m] and normals that span the same cone of support wrenches, to about 1e-3.

    On one plane all wrenches N (n - mu t) share n and t and are affine in the point, so the convex hull's corners
    generate every non-negative combination; corners that stand out by less than `tolerance` * half_length go too,
    and the cone can only shrink. Where the surroundings have so many planes that over 96 points remain, planes
    within about 6 degrees share a hull; the kept points keep their own normals.
    """
    if len(points) == 0:
        return points, normals
    sizes = {"half_length": half_length, "tolerance": tolerance}
    kept = _corners_by_plane(points, normals, **sizes, step=NORMAL_STEP, use_offset=True)
    if len(kept) > MANY_SUPPORTS:
        coarse = _corners_by_plane(points[kept], normals[kept], **sizes, step=COARSE_NORMAL_STEP, use_offset=False)
        kept = kept[coarse]
    return points[kept], normals[kept]


def _corners_by_plane(
    points: _Points, normals: _Points, *, half_length: float, tolerance: float, step: float, use_offset: bool
) -> Int[np.ndarray, "kept"]:
    """Return the indices of the hull corners of each group of like planes."""
    offset = np.einsum("px,px->p", points - points.mean(axis=0), normals) / half_length
    keys = np.concatenate([normals, offset[:, None]], axis=1) if use_offset else normals
    plane = distinct_rows(np.round(keys / step).astype(np.int64))[1]
    order = np.argsort(plane, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(plane[order])) + 1)
    return np.concatenate(
        [group[hull_corners(points[group], normals[group[0]], tolerance=tolerance * half_length)] for group in groups]
    )


def hull_corners(points: _Points, normal: Float[np.ndarray, "3"], *, tolerance: float) -> Int[np.ndarray, "corner"]:
    """Return the indices of the corners of the convex hull of `points` seen along `normal`.

    A corner less than `tolerance` [m] outside the chord of its neighbours is dropped, the flattest first, and so are
    corners beyond 32. Points on one line give its two ends; one point gives itself.
    """
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first)
    flat = (points - points[0]) @ np.stack([first, np.cross(normal, first)]).T
    spread = flat - flat.mean(axis=0)
    directions = np.linalg.svd(spread, full_matrices=False)[2]
    along, across = spread @ directions[0], spread @ directions[-1]
    if len(points) < 3 or np.ptp(across) <= tolerance:
        ends = [int(np.argmin(along)), int(np.argmax(along))]
        return np.array(ends if np.ptp(along) > tolerance else ends[:1])
    outer = outer_points(flat)
    try:
        corners = outer[ConvexHull(flat[outer]).vertices].tolist()
    except QhullError:
        return np.array([int(np.argmin(along)), int(np.argmax(along))])
    return np.array(_sharpest(corners, flat, tolerance))


def outer_points(flat: Float[np.ndarray, "point 2"]) -> Int[np.ndarray, " outer"]:
    """Return the points among which the corners of the convex hull are: those not within the octagon of the farthest.

    flat: [m]. All of them where they lie in one place.
    """
    farthest = flat[(flat @ DIRECTIONS).argmax(axis=0)]
    side = np.roll(farthest, -1, axis=0) - farthest
    if not (apart := side.any(axis=1)).any():
        return np.arange(len(flat))
    farthest, side = farthest[apart], side[apart]
    outward = np.stack([side[:, 1], -side[:, 0]])
    beyond = flat @ outward - np.einsum("kx,xk->k", farthest, outward)
    return np.flatnonzero((beyond >= -INSIDE * np.abs(side).sum(axis=1)).any(axis=1))


def _sharpest(corners: list[int], flat: Float[np.ndarray, "point 2"], tolerance: float) -> list[int]:
    """Return the corners of an outline without the flattest, one after another; see `hull_corners`.

    Dropping one changes the heights of its two neighbours alone.
    """
    count = len(corners)
    before, after = [place - 1 for place in range(count)], [place + 1 for place in range(count)]
    before[0], after[-1] = count - 1, 0
    places = [(float(x), float(y)) for x, y in flat[corners]]

    def height(place: int) -> float:
        """Distance from the line through its two neighbours [m]."""
        (ax, ay), (x, y), (bx, by) = places[before[place]], places[place], places[after[place]]
        chord_x, chord_y = bx - ax, by - ay
        return abs(chord_x * (y - ay) - chord_y * (x - ax)) / max(float(np.sqrt(chord_x**2 + chord_y**2)), 1e-12)

    heights = [height(place) for place in range(count)]
    flattest = [*zip(heights, range(count), strict=True)]
    heapify(flattest)
    left = count
    while left > 3:
        found, place = heappop(flattest)
        if found != heights[place]:  # no longer
            continue
        if found > tolerance and left <= MAX_CORNERS:
            break
        heights[place], left = np.nan, left - 1
        after[before[place]], before[after[place]] = after[place], before[place]
        for neighbour in (before[place], after[place]):
            heights[neighbour] = height(neighbour)
            heappush(flattest, (heights[neighbour], neighbour))
    return [corner for corner, height in zip(corners, heights, strict=True) if not np.isnan(height)]
