"""Depth completed by planes where nothing was measured: in the holes of a shiny floor, and behind the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_closing, distance_transform_edt, minimum_filter, uniform_filter
from scipy.spatial import ConvexHull, QhullError, cKDTree

from dexnudge.perception.depth_view import DepthView
from dexnudge.perception.planes import CELL, Plane, merged_points

GAP_PIXELS = 7  # up to which a gap in an image is one: windows of matching are 5 to 9 wide
WALL_GAP = 0.06  # [m] from what was measured of a wall to where it is assumed; floors are continued without limit
BEHIND = 0.02  # [m] a point that lies farther behind a plane was seen through it, or mirrored in it
NOT_BEHIND = 0.004  # [m] nearer behind a plane a point is on it
MIRROR_TOLERANCE = 0.05  # [m] between a mirrored point and what it is the image of: twice the error of a floor's height
SEEN_THROUGH = 3  # rays through a cell and its neighbours that open it, if more than those that met a mirror image


def complete(views: Sequence[DepthView], planes: Sequence[Plane]) -> list[DepthView]:
    """Return the views with depth where none was measured and a plane behind is the likely surface, marked `assumed`.

    A pixel that measured nothing, that shows the object (`mask`), or that shows a mirror image gets the depth of the first
    plane that its ray meets inside that plane's patch, unless another view measured a surface in front of it. The patch is
    what lies inside the convex hull of its points (of a floor: of all that was measured at its height), without the
    parts nearest to which other rays went through the plane: those are openings. Walls are continued by at most 6 cm.
    """
    if not planes:
        return list(views)
    bare = [without_object(view) for view in views]
    points = np.concatenate([plane.points for plane in planes])
    low, high = points.min(axis=0) - 4 * CELL, points.max(axis=0) + 4 * CELL
    merged = merged_points(bare, low, high)
    sources = merged_points(views, low, high)  # the object is mirrored too
    planes = [plane for plane in planes if not _is_image(plane, planes)]
    patches = [_patch(plane, bare, merged, sources) for plane in planes]
    done = [_completed(view, patches, merged) for view in bare]
    return [_with_rest(view, before) for view, before in zip(done, views, strict=True)]


def _with_rest(view: DepthView, before: DepthView) -> DepthView:
    """Return the completed view with what the object's pixels measured where nothing is known of what is behind."""
    assert view.assumed is not None
    return replace(view, depth=np.where(view.assumed | view.measured, view.depth, before.depth))


def bridged(view: DepthView) -> DepthView:
    """Return a view whose narrow gaps between measured pixels are free as far as the nearest of these.

    Cameras drop the pixels at edges; without them a wedge that no ray passed would reach from each edge to the camera. The
    bridged pixels count as the object's: no surface, but free before them.
    """
    gaps = binary_closing(view.measured, structure=np.ones((GAP_PIXELS, GAP_PIXELS))) & ~view.measured
    nearest = minimum_filter(np.where(view.measured, view.depth, np.inf), size=GAP_PIXELS)
    mask = gaps if view.mask is None else gaps | view.mask
    return replace(view, depth=np.where(gaps, nearest, view.depth), mask=mask)


def _is_image(plane: Plane, planes: Sequence[Plane]) -> bool:
    """Whether an upright plane lies for the most part behind a larger floor: mirrored in it, or below it."""
    return not plane.level and any(
        each.level and len(each.points) > len(plane.points) and np.median(each.heights(plane.points)) < -each.band
        for each in planes
    )


def without_object(view: DepthView) -> DepthView:
    """Return a view in which the object's pixels measured nothing; one that would measure nothing at all stays as it is."""
    if view.mask is None or not (view.measured & ~view.mask).any():
        return view
    return replace(view, depth=np.where(view.mask, 0.0, view.depth))


@dataclass(frozen=True, eq=False)
class _Patch:
    """Where a plane is surface: `covers` cells of its own lattice, whose axes are the rows of `axes`."""

    plane: Plane
    axes: Float[np.ndarray, "2 3"]
    corner: Float[np.ndarray, "2"]
    covers: Bool[np.ndarray, "row column"]
    mirrors: cKDTree

    def has(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        return _at(self.covers, _cells(points, self.axes, self.corner))

    def mirrored(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether points behind the plane are images of what was measured before it: floors shine, openings do not."""
        if not self.plane.level:
            return np.zeros(len(points), dtype=bool)
        images = points - 2 * self.plane.heights(points)[:, None] * self.plane.normal
        if not self.mirrors.n:
            return np.zeros(len(points), dtype=bool)
        return np.asarray(self.mirrors.query(images, distance_upper_bound=MIRROR_TOLERANCE)[0] < np.inf)


def _cells(points: np.ndarray, axes: np.ndarray, corner: np.ndarray) -> np.ndarray:
    return np.floor((points @ axes.T - corner) / CELL).astype(np.int64)


def _at(lattice: np.ndarray, cells: np.ndarray) -> np.ndarray:
    inside = ((cells >= 0) & (cells < lattice.shape)).all(axis=1)
    found = np.zeros(len(cells), dtype=bool)
    found[inside] = lattice[tuple(cells[inside].T)]
    return found


def _patch(
    plane: Plane, views: Sequence[DepthView], merged: Float[np.ndarray, "n 3"], sources: Float[np.ndarray, "m 3"]
) -> _Patch:
    """Return where a plane is surface: nearer to something measured at its height than to a ray that went through it."""
    standing = merged[np.abs(plane.heights(merged)) < plane.band]
    if plane.level and len(standing):  # what stands on a floor tells of it as its own points do
        patch, open_share = _patch_of(plane, np.concatenate([plane.points, standing]), views, sources)
        if open_share < 0.5:
            return patch
    patch = _patch_of(plane, plane.points, views, sources)[0]
    here = np.zeros(patch.covers.shape, dtype=bool)
    here[tuple(_cells(plane.points, patch.axes, patch.corner).T)] = True
    return replace(patch, covers=patch.covers & (distance_transform_edt(~here) < WALL_GAP / CELL))


def _patch_of(
    plane: Plane, at_height: Float[np.ndarray, "k 3"], views: Sequence[DepthView], sources: Float[np.ndarray, "m 3"]
) -> tuple[_Patch, float]:
    """Return the patch inside the hull of these points, and which share of what is known of the hull is open."""
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    flat = at_height @ axes.T
    corner = flat.min(axis=0) - 2 * CELL
    rows, columns = (np.ceil((flat.max(axis=0) - corner) / CELL).astype(int) + 2).tolist()
    shape = (rows, columns)
    mirrors = cKDTree(sources[plane.heights(sources) > 0.5 * plane.band])
    patch = _Patch(plane, axes, corner, _inside_hull(flat, corner, shape), mirrors)
    here = np.zeros(shape, dtype=bool)
    here[tuple(_cells(at_height, axes, corner).T)] = True
    through, images = np.zeros(shape), np.zeros(shape)
    for view in views:
        crossings, mirrored = _crossings(patch, view)
        for counts, kind in ((through, ~mirrored), (images, mirrored)):
            np.add.at(counts, tuple(_cells(crossings[kind], axes, corner).T), 1)
    opened = (through > 0) & ~here
    through, images = (9 * uniform_filter(counts, size=3, mode="constant") for counts in (through, images))
    opened &= (through > SEEN_THROUGH - 0.5) & (through > images)
    if not opened.any():
        return patch, 0.0
    nearer = distance_transform_edt(~here) <= distance_transform_edt(~opened)
    return replace(patch, covers=patch.covers & nearer), float(opened.sum() / (opened.sum() + here.sum()))


def _crossings(patch: _Patch, view: DepthView) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Return where a view's rays crossed a plane to what they measured behind it, and which measured a mirror image."""
    points = view.points()
    points = points[patch.plane.heights(points) < -BEHIND]
    position = view.T_world_camera[:3, 3]
    start = float(position @ patch.plane.normal - patch.plane.offset)
    if start <= 0:
        return np.zeros((0, 3)), np.zeros(0, dtype=bool)
    share = start / (start - patch.plane.heights(points))
    crossings = position + share[:, None] * (points - position)
    inside = patch.has(crossings)
    return crossings[inside], patch.mirrored(points[inside])


def _inside_hull(flat: np.ndarray, corner: np.ndarray, shape: tuple[int, int]) -> Bool[np.ndarray, "row column"]:
    rows, columns = np.indices(shape)
    centres = corner + (np.stack([rows.ravel(), columns.ravel()], axis=1) + 0.5) * CELL
    try:
        hull = ConvexHull(flat)
    except QhullError:  # all on a line
        return np.zeros(shape, dtype=bool)
    return (centres @ hull.equations[:, :2].T + hull.equations[:, 2] <= CELL).all(axis=1).reshape(shape)


def _completed(view: DepthView, patches: Sequence[_Patch], merged: Float[np.ndarray, "n 3"]) -> DepthView:
    depth = view.depth.astype(np.float64)
    rows, columns = np.indices(depth.shape)
    in_camera = np.stack([(columns - view.cx) / view.fx, (rows - view.cy) / view.fy, np.ones_like(depth)], axis=-1)
    rays = in_camera.reshape(-1, 3) @ view.T_world_camera[:3, :3].T  # of depth 1
    position = view.T_world_camera[:3, 3]
    measured = np.where(depth > 0, depth, np.inf).reshape(-1)
    in_front = _nearest_measured(view, merged).reshape(-1)
    best = np.full(depth.size, np.inf)
    for patch in patches:
        plane = patch.plane
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (plane.offset - position @ plane.normal) / (rays @ plane.normal)
        # Not measured, or measured far enough behind the plane to be a mirror image.
        asked = np.flatnonzero((z > 0) & (z < best) & (z < measured))
        asked = asked[patch.has(position + z[asked, None] * rays[asked])]
        asked = asked[in_front[asked] > z[asked] - BEHIND]
        seen = np.isfinite(measured[asked])
        points = position + measured[asked[seen], None] * rays[asked[seen]]
        images = np.zeros(len(points), dtype=bool)
        behind = plane.heights(points) < -max(0.5 * plane.band, NOT_BEHIND)
        if behind.any():
            images[behind] = patch.mirrored(points[behind])
        keep = ~seen
        keep[seen] = images
        best[asked[keep]] = z[asked[keep]]
    filled = np.isfinite(best).reshape(depth.shape)
    assumed = filled if view.assumed is None else filled | view.assumed
    return replace(view, depth=np.where(filled, best.reshape(depth.shape), depth), assumed=assumed)


def _nearest_measured(view: DepthView, merged: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "height width"]:
    """Return the depth [m] at which any view measured something on each pixel's ray; infinite where none did."""
    nearest = np.full(view.depth.shape, np.inf)
    u, v, z = view.project(merged[view.sees(merged)]).T
    np.minimum.at(
        nearest, (np.rint(v).astype(int).clip(0, view.height - 1), np.rint(u).astype(int).clip(0, view.width - 1)), z
    )
    pixels = int(np.ceil(CELL * view.fx / np.median(z))) if len(z) else 1  # as large as a cell of the merged points
    return minimum_filter(nearest, size=pixels | 1)
