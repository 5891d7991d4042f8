"""The shape of an object that is known only from its masks: its outline, down to what carries it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from dexnudge.errors import SceneError
from dexnudge.perception.depth_view import DepthView
from dexnudge.perception.planes import Plane, cell_means, find_planes

BORDER = 1  # pixels by which a mask is shrunk: at its border a pixel shows both object and background
JUMP = 0.015  # [m] by which depth changes between neighbouring pixels only at an edge
REACH = 0.35  # [m] around the masked points in which planes are looked for
LINK = 0.025  # [m] farther apart two groups of points are not one object
LATTICE = 0.006  # [m] points are thinned to
LARGEST = 0.6  # [m] of an object that a hand pushes
LEAST_POINTS = 30  # thinned: 10 cm^2
OWN_PLANE, FOREIGN_PLANE = 0.25, 0.12  # share of a plane's points that are masked: a face of the object; not one
TOP_GAP = 0.08  # [m] over which a top of which little was measured is still one
UPRIGHT_FACE = 0.15  # |cosine| of a face's normal to the vertical: within 9 degrees
GROWN = 0.03  # [m] past its mask an object's own face is followed: masks are coarse
TOP_QUANTILE = 0.97  # of the heights: stray points lie above
BELOW_LIMIT = 0.35  # [m] that an object reaches down to what carries it, at most
DIRECTIONS = 64  # in which the outline is measured
OUTLINE_QUANTILE = 0.995  # of the points in each direction: stray points lie outside
RECTANGULAR = 0.88  # of its smallest rectangle that an outline fills to be taken for it: a disc fills 0.785
LEAST_DEPTH = 0.01  # [m] of an object of which one upright face was seen


@dataclass(frozen=True, eq=False)
class MaskedObject:
    """What an object is taken to be.

    Attributes:
        mesh: closed prism [m]; its frame lies in its centre, x along the longer side of the outline, z up from the support.
        T_world_object: (4, 4).
        support: the plane that it stands on.
        assumed: what was not measured, a sentence each.
    """

    mesh: trimesh.Trimesh
    T_world_object: Float[np.ndarray, "4 4"]
    support: Plane
    assumed: tuple[str, ...]


def masked_object(views: Sequence[DepthView]) -> MaskedObject:
    """Return the prism that stands for the object of the views' masks.

    Its outline is that of the masked points, seen along the normal of the plane that carries it; it reaches from that
    plane up to its top. Masks may be coarse, partial, and at places wrong.

    Raises:
        SceneError: no masks, no depth in them, points of more than 0.6 m, or no level plane below them.
    """
    masked = _masked_points(views)
    spread = np.ptp(np.percentile(masked, [5, 95], axis=0), axis=0)
    if (width := float(spread.max())) > LARGEST:
        raise SceneError(
            f"the masked points are scattered over {width:.2f} m; expected an object of at most {LARGEST} m; do all masks "
            "show the same object, and are `depth_unit` and `T_world_camera` right?"
        )
    middle = np.median(masked, axis=0)
    planes = find_planes([replace(view, mask=None) for view in views], middle - REACH, middle + REACH)
    tree = cKDTree(masked)
    shares = [float((tree.query(each.points)[0] < LATTICE).mean()) for each in planes]
    support = _support(planes, shares, masked)
    kept = masked[support.heights(masked) > -support.band]
    for plane, share in zip(planes, shares, strict=True):
        if plane is not support and share < FOREIGN_PLANE:
            kept = kept[np.abs(plane.heights(kept)) > plane.band]
    kept = cell_means(kept, LATTICE)[0]
    kept = np.concatenate([group := _largest_group(kept), _level_with_top(kept, group, support)])
    if len(kept) < LEAST_POINTS:
        raise SceneError(
            f"{len(kept)} points of the masks belong together; expected at least {LEAST_POINTS}; is the mask too small, or "
            "does the object measure no depth (black, transparent, shiny)?"
        )
    own = [plane for plane, share in zip(planes, shares, strict=True) if plane is not support and share >= OWN_PLANE]
    kept = _grown(kept, own, support)
    if (width := float(np.ptp(kept, axis=0).max())) > LARGEST:
        raise SceneError(
            f"the masked points reach over {width:.2f} m; expected an object of at most {LARGEST} m; does the "
            "mask show more?"
        )
    return _prism(kept, support, own, np.mean([view.T_world_camera[:3, 3] for view in views], axis=0))


def _masked_points(views: Sequence[DepthView]) -> Float[np.ndarray, "n 3"]:
    if not any(view.mask is not None and view.mask.any() for view in views):
        raise SceneError(
            "no view has a mask with pixels; expected the object's in at least one; give `mask` in cameras.json or "
            "`masks`, or OBJECT as a mesh with its `object_pose`"
        )
    points = [view.points(_reliable(view)) for view in views if view.mask is not None]
    points = [each for each in points if len(each)]
    if not points:
        raise SceneError(
            "no masked pixel has depth that can be relied on; expected measured pixels inside the masks; is the object "
            "black, transparent or shiny, or is the mask of another image?"
        )
    return np.concatenate(points)


def _reliable(view: DepthView) -> Bool[np.ndarray, "height width"]:
    """Return the masked pixels inside the mask's border whose depth does not jump."""
    assert view.mask is not None
    nearest = minimum_filter(np.where(view.measured, view.depth, np.inf), size=3)
    farthest = maximum_filter(np.where(view.measured, view.depth, -np.inf), size=3)
    inner = binary_erosion(view.mask, iterations=BORDER)
    return inner & view.measured & (farthest - nearest < JUMP)


def _largest_group(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 3"]:
    if not len(points):
        return points
    pairs = cKDTree(points).query_pairs(LINK, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    labels = connected_components(graph, directed=False)[1]
    return points[labels == np.bincount(labels).argmax()]


def _level_with_top(
    points: Float[np.ndarray, "n 3"], group: Float[np.ndarray, "k 3"], support: Plane
) -> Float[np.ndarray, "m 3"]:
    """Return points that are not in the group but level with its top, near it: a top seen at a low angle has gaps."""
    if not len(group):
        return group
    axes = np.linalg.svd(support.normal[None])[2][1:]
    top = np.quantile(support.heights(group), TOP_QUANTILE)
    level = points[np.abs(support.heights(points) - top) < 2 * support.noise]
    distance = cKDTree(group @ axes.T).query(level @ axes.T)[0]
    return level[(distance > 0) & (distance < TOP_GAP)]


def _support(planes: Sequence[Plane], shares: Sequence[float], masked: Float[np.ndarray, "n 3"]) -> Plane:
    """Return the highest level plane, of the larger ones, that the object does not reach below and that lies near it."""
    middle = np.median(masked, axis=0)
    found = []
    for plane, share in zip(planes, shares, strict=True):
        if not plane.level or share >= OWN_PLANE:
            continue
        heights = plane.heights(masked)
        below = float(np.median(heights))
        near = np.linalg.norm((plane.points - middle)[:, :2], axis=1).min()
        if -plane.band < below < BELOW_LIMIT and near < BELOW_LIMIT:
            found.append((below, plane))
    if not found:
        levels = [f"{each.offset / each.normal[2]:.3f}" for each in planes if each.level]
        raise SceneError(
            f"no level plane is found below the masked points, near z = {middle[2]:.3f} m; expected what the object stands "
            f"on within {1e3 * BELOW_LIMIT:.0f} mm; level planes found at z = {', '.join(levels) or 'none'}; does a view "
            "see the support, and is z up in `T_world_camera`?"
        )
    largest = max(len(plane.points) for _, plane in found)
    return min((each for each in found if len(each[1].points) > largest / 3), key=lambda each: each[0])[1]


def _grown(points: Float[np.ndarray, "n 3"], faces: Sequence[Plane], support: Plane) -> Float[np.ndarray, "k 3"]:
    """Return the points, and those of the object's own faces that lie close to them."""
    tree = cKDTree(points)
    more = [points]
    for face in faces:
        close = tree.query(face.points)[0] < GROWN
        more.append(face.points[close & (support.heights(face.points) > -support.band)])
    return cell_means(np.concatenate(more), LATTICE)[0]


def _prism(
    points: Float[np.ndarray, "n 3"], support: Plane, faces: Sequence[Plane], cameras: Float[np.ndarray, "3"]
) -> MaskedObject:
    up = support.normal
    axes = np.linalg.svd(up[None])[2][1:]
    heights = support.heights(points)
    for face in faces:  # a convex object lies behind each of its faces
        if abs(face.normal @ up) < UPRIGHT_FACE:
            points = points - np.maximum(face.heights(points), 0)[:, None] * face.normal
    flat = points @ axes.T
    top = float(np.quantile(heights, TOP_QUANTILE))
    tops = [each for each in faces if each.normal @ up > np.cos(np.radians(25.0))]
    level = [float(np.median(support.heights(each.points))) for each in tops]
    seen_top = [each for each in level if abs(each - top) < max(0.25 * top, 3 * support.noise)]
    top = max(seen_top, default=top)
    if top < max(support.noise, 0.001):
        raise SceneError(
            f"the masked points lie {1e3 * top:.1f} mm above their support, whose noise is {1e3 * support.noise:.1f} mm; "
            "expected an object that stands out of it; is the mask of the object?"
        )
    assumed = [
        f"the object is taken for the outline of its masked points, {1e3 * top:.0f} mm high, down to its support: a prism"
    ]
    away = axes @ (points.mean(axis=0) - cameras)
    outline, deepened = _outline(flat, away / np.linalg.norm(away))
    if deepened:
        assumed.append(f"only its front was seen: it is taken to be {1e3 * LEAST_DEPTH:.0f} mm deep")
    elif not seen_top:
        assumed.append(
            "its top was not seen as a plane: its height is that of its highest points, its depth what was seen"
        )
    upright = [axes @ face.normal for face in faces if abs(face.normal @ up) < UPRIGHT_FACE]
    corner, sides, x_axis = smallest_rectangle(outline, upright)
    middle = corner + (sides / 2) @ x_axis
    local = (outline - middle) @ x_axis.T
    if upright or ConvexHull(outline).volume >= RECTANGULAR * sides[0] * sides[1]:
        half = sides / 2
        local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
        why = "as it has an upright flat face" if upright else "which it nearly fills"
        assumed.append(f"its outline is taken for a rectangle, {why}: {1e3 * sides[0]:.0f} x {1e3 * sides[1]:.0f} mm")
    pose = np.eye(4)
    pose[:3, 0] = x_axis[0] @ axes
    pose[:3, 2] = up
    pose[:3, 1] = np.cross(pose[:3, 2], pose[:3, 0])
    # The outline in the frame of the pose, whose y may run against the second row of x_axis.
    local = (local @ x_axis) @ axes @ pose[:3, :2]
    pose[:3, 3] = middle @ axes + up * (support.offset + top / 2)
    return MaskedObject(prism(local, top), pose, support, tuple(assumed))


def _outline(flat: Float[np.ndarray, "n 2"], away: Float[np.ndarray, "2"]) -> tuple[Float[np.ndarray, "k 2"], bool]:
    """Return the convex outline of points without stray ones, and whether it had to be made deeper."""
    angles = np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reach = np.quantile(flat @ directions.T, OUTLINE_QUANTILE, axis=0)
    inside = (flat @ directions.T <= reach + 1e-9).all(axis=1)
    kept = flat[inside] if inside.sum() >= 3 else flat
    depth = float(np.ptp(kept @ away))
    deepened = depth < LEAST_DEPTH
    if deepened:
        kept = np.concatenate([kept, kept + (LEAST_DEPTH - depth) * away])
    try:
        return kept[ConvexHull(kept).vertices], deepened  # against the clock
    except QhullError as error:
        raise SceneError(
            "the masked points lie on a line; expected an object with an outline; is the mask too thin?"
        ) from error


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


def prism(outline: Float[np.ndarray, "k 2"], height: float) -> trimesh.Trimesh:
    """Return a closed prism over a convex outline [m], from -height / 2 to height / 2."""
    around = outline[ConvexHull(outline).vertices]  # against the clock
    corners = np.arange(len(around))
    fan = np.column_stack([np.zeros(len(around) - 2, dtype=int), corners[1:-1], corners[2:]])
    mesh = trimesh.creation.extrude_triangulation(around, fan, height)
    mesh.apply_translation((0.0, 0.0, -height / 2))
    return mesh
