"""Point clouds as depth views: what stood before each view point, at the density of the points."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from dexnudge.errors import SceneError, quote
from dexnudge.geometry.rigid import FARTHEST as FARTHEST_POINT
from dexnudge.jobs.json_files import read_json
from dexnudge.perception.depth_view import FARTHEST, NEAREST, DepthView
from dexnudge.perception.point_cloud_files import checked_points, load_point_cloud

MAX_VIEW_POINTS = 64
SAMPLED = 5_000  # points at which the density is measured
NEIGHBOURS = 8  # of a point, whose distance tells the density
PIXEL = (
    1.5  # spacings of points that a pixel is wide: nine of ten pixels of a surface hold a point, the rest is bridged
)
SPARSE_SHARE = 0.25  # of the points that may be sparser than that
LARGEST_IMAGE = 2000  # [px] along a side of 90 degrees
LEAST_POINTS = 3  # of an image: fewer are no surface
WITHIN = 1.5  # pixels on the surface within which points behind the nearest one of a pixel belong to it


def cloud_views(cloud: str | Path | Float[np.ndarray, "n 3"], view_points: Any = None) -> list[DepthView]:
    """Return depth views that say of a point cloud what is surface, free and unseen, for `fuse`.

    The cloud is projected onto the faces of a cube around each view point; each pixel keeps the nearest surface.

    Args:
        cloud: points [m, world], or a file: `.ply` without faces, `.pcd`, `.npy`.
        view_points: (k, 3) or (3,) where the sensor stood [m, world], or a JSON file with a list of them; None where a
            `.pcd` says it (VIEWPOINT).

    Raises:
        SceneError: a file that is missing or damaged, no or too few points, NaN, view points that are none or are not
            given, or distances that no workplace has.
    """
    name = str(cloud) if isinstance(cloud, str | Path) else "the point cloud"
    stated = None
    if isinstance(cloud, str | Path):
        loaded = load_point_cloud(cloud)
        points, stated = loaded.points, loaded.view_point
    else:
        points = checked_points(np.asarray(cloud), name)
    if np.abs(points).max() > FARTHEST_POINT:
        raise SceneError(
            f"{name}: a point is {np.abs(points).max():.3g} m away; expected metres; is it in millimetres?"
        )
    stood = _view_points(view_points, stated, name)
    views: list[DepthView] = []
    spacing, sample = _spacing(points, name)
    for number, place in enumerate(stood):
        away = np.linalg.norm(sample - place, axis=1)
        if not NEAREST <= np.median(away) <= FARTHEST:
            raise SceneError(
                f"{name}: lies {np.median(away):.3g} m from view point {number} in the median; expected {NEAREST:g} to "
                f"{FARTHEST:g} m; are both in metres, in the world's frame?"
            )
        focal = float(np.quantile(away / (PIXEL * spacing), SPARSE_SHARE))
        views += _cube(points, place, min(focal, LARGEST_IMAGE / 2), f"{name}, view point {number}")
    if not views:
        raise SceneError(f"{name}: no view point has {LEAST_POINTS} points in sight; expected a surface")
    return views


def _view_points(given: Any, stated: Float[np.ndarray, "3"] | None, name: str) -> Float[np.ndarray, "k 3"]:
    """Return where the sensor stood, (k, 3) [m]."""
    if given is None:
        if stated is None:
            raise SceneError(f"{name}: `view_points` is missing; expected (k, 3), where the sensor stood [m, world]")
        return stated[None]
    where = str(given) if isinstance(given, str | Path) else "`view_points`"
    values = read_json(Path(given)) if isinstance(given, str | Path) else given
    try:
        places = np.atleast_2d(np.asarray(values))
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise SceneError(f"{where}: is {quote(values)}; expected a list of x, y, z [m]") from error
    if places.dtype.kind not in "iuf":
        raise SceneError(f"{where}: is {quote(values)}; expected a list of x, y, z [m]")
    if places.ndim != 2 or places.shape[1] != 3 or not 1 <= len(places) <= MAX_VIEW_POINTS:
        raise SceneError(f"{where}: has shape {places.shape}; expected (k, 3) with k from 1 to {MAX_VIEW_POINTS}")
    if not np.isfinite(places).all():
        raise SceneError(f"{where}: holds NaN or infinity; expected where the sensor stood [m, world]")
    return places.astype(np.float64)


def _spacing(points: Float[np.ndarray, "n 3"], name: str) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, "s 3"]]:
    """Return how far points of a surface lie from one another [m], at a sample of them, and the sample."""
    if len(points) <= NEIGHBOURS:
        raise SceneError(f"{name}: holds {len(points)} points; expected a surface, thousands of them")
    sample = points[:: max(len(points) // SAMPLED, 1)]
    reach = cKDTree(points).query(sample, k=NEIGHBOURS + 1)[0][:, -1]
    spacing = reach * np.sqrt(np.pi / NEIGHBOURS)  # of points spread evenly over a plane
    if not (spacing > 0).any():
        raise SceneError(f"{name}: its points lie in one place; expected a surface, in metres")
    return np.maximum(spacing, np.median(spacing[spacing > 0]) / 10), sample


def _cube(
    points: Float[np.ndarray, "n 3"], place: Float[np.ndarray, "3"], focal: float, name: str
) -> Iterator[DepthView]:
    """Yield the faces of a cube around a view point on which points fall; the first looks toward their middle."""
    forward = points.mean(axis=0) - place
    forward = forward / np.linalg.norm(forward) if np.linalg.norm(forward) > 0 else np.array([1.0, 0, 0])
    helper = np.eye(3)[np.argmin(np.abs(forward))]
    right = np.cross(forward, helper)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    local = (points - place) @ axes.T
    across = np.abs(local).argmax(axis=1)
    ahead_of_it = np.take_along_axis(local, across[:, None], axis=1)[:, 0] > 0
    depth = np.abs(local).max(axis=1)
    across[(depth < NEAREST) | (depth > FARTHEST)] = -1  # the sensor itself, or outside the workplace
    for axis, sign in itertools.product((2, 0, 1), (1, -1)):
        seen = (across == axis) & (ahead_of_it == (sign > 0))
        if seen.sum() >= LEAST_POINTS:
            turned = np.stack([axes[axis - 2], sign * axes[axis - 1], sign * axes[axis]])
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = turned.T, place
            yield _image((points[seen] - place) @ turned.T, pose, focal, name)


def _image(points: Float[np.ndarray, "n 3"], pose: Float[np.ndarray, "4 4"], focal: float, name: str) -> DepthView:
    """Return the depth of the nearest surface in each pixel, of points in the camera frame; as large as they need."""
    z = points[:, 2]
    at = np.floor(focal * points[:, :2] / z[:, None] + 0.5).astype(np.int64)
    first = np.minimum(at.min(axis=0), 0)  # the principal point stays inside
    width, height = (np.maximum(at.max(axis=0), 0) - first + 1).tolist()
    pixel = (at[:, 1] - first[1]) * width + at[:, 0] - first[0]
    nearest = np.full(width * height, np.inf)
    np.minimum.at(nearest, pixel, z)
    near = z <= nearest[pixel] * (1 + WITHIN / focal)
    total = np.bincount(pixel[near], 1 / z[near], minlength=width * height)
    count = np.bincount(pixel[near], minlength=width * height)
    depth = np.divide(count, total, out=np.zeros(width * height), where=total > 0)
    return DepthView(depth.reshape(height, width), focal, focal, float(-first[0]), float(-first[1]), pose, name=name)
