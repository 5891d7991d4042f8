"""Point clouds out of files (`.ply` without faces, `.pcd`, `.npy`) as depth views: what stood before each view point."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree

from dexnudge.errors import SceneError, check_path, quote, what_failed
from dexnudge.geometry.mesh_files import PARSE_ERRORS
from dexnudge.geometry.rigid import FARTHEST as FARTHEST_POINT
from dexnudge.jobs.json_files import read_json
from dexnudge.perception.depth_view import FARTHEST, NEAREST, DepthView

FORMATS = (".ply", ".pcd", ".npy")
MAX_POINTS = 20_000_000  # of a scanner that turns once; kept as 0.5 GB
MAX_BYTES = 2_000_000_000
PCD_HEADER = 10_000  # bytes in which a PCD's header must end
PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8"} | {
    (kind, size): f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)
}
REMEDY = "the file is truncated, damaged or no point cloud; write it again"


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points [m]; `view_point` [m] from which they were measured, where the file says it."""

    points: Float[np.ndarray, "n 3"]
    view_point: Float[np.ndarray, "3"] | None = None


def load_point_cloud(path: str | Path) -> PointCloud:
    """Read the points of a file.

    `.npy`: (n, 3), or (n, 6) with normals, which are not used; (height, width, 3 or 6) where pixels without depth are NaN.
    `.pcd`: fields x, y, z, as ASCII or binary; NaN where it is organised (HEIGHT above 1). `.ply`: vertices without faces.

    Raises:
        SceneError: missing, damaged, of another format, with faces, without points, too many, or with NaN or infinity
            where no pixels are.
    """
    check_path("point cloud", path, SceneError)
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise SceneError(f"{path}: unknown format {path.suffix!r} of a point cloud; expected {', '.join(FORMATS)}")
    try:
        if not path.is_file():
            raise SceneError(f"{path}: no such file; expected a point cloud, {', '.join(FORMATS)}")
        if path.stat().st_size > MAX_BYTES:
            raise SceneError(f"{path}: is larger than {MAX_BYTES / 1e9:g} GB; expected a point cloud; thin it out")
        with path.open("rb") as file, np.errstate(all="ignore"):
            points, organised, view_point = READERS[kind](file, path)
            points = points.astype(np.float64) if points.dtype.kind in "fiu" else points
    except (*PARSE_ERRORS, TokenError, MemoryError, OSError) as error:
        if isinstance(error, SceneError):
            raise
        what = what_failed(error) if isinstance(error, OSError) else type(error).__name__
        if isinstance(error, MemoryError):
            what = "the memory does not suffice"
        raise SceneError(f"{path}: cannot be read as {kind[1:]} ({what}); {REMEDY}") from error
    return PointCloud(checked_points(points, str(path), organised=organised), view_point)


def checked_points(points: np.ndarray, name: str, *, organised: bool = False) -> Float[np.ndarray, "n 3"]:
    """Return the finite points of (n, 3) numbers as float64.

    organised: whether they are pixels, of which those without depth are not finite.

    Raises:
        SceneError: of another shape, none, too many, or not finite where they are no pixels.
    """
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise SceneError(f"{name}: has shape {points.shape} of {points.dtype}; expected real numbers, (n, 3) or (n, 6)")
    if len(points) > MAX_POINTS:
        raise SceneError(f"{name}: {len(points):,} points; expected at most {MAX_POINTS:,}; thin it out to 2 mm")
    points = np.asarray(points, dtype=np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not organised and not finite.all():
        raise SceneError(
            f"{name}: {int((~finite).sum()):,} of {len(points):,} points hold NaN or infinity, the first is number "
            f"{int(np.argmin(finite))}; expected finite numbers; remove them, or keep the cloud organised (height above 1)"
        )
    if not finite.any():
        raise SceneError(f"{name}: holds no point; expected points in metres")
    return points[finite]


def _read_npy(_: BinaryIO, path: Path) -> tuple[np.ndarray, bool, None]:
    values = np.load(path, mmap_mode="r", allow_pickle=False)  # compares what is announced with the file's size first
    if values.ndim not in (2, 3) or values.shape[-1] not in (3, 6):
        raise SceneError(f"{path}: has shape {values.shape}; expected (n, 3), (n, 6) or (height, width, 3)")
    return values.reshape(-1, values.shape[-1])[:, :3], values.ndim == 3, None


def _read_ply(file: BinaryIO, path: Path) -> tuple[np.ndarray, bool, None]:
    cloud = trimesh.load(file, file_type="ply", process=False)
    if not isinstance(cloud, trimesh.PointCloud):
        raise SceneError(f"{path}: has faces; expected a point cloud; pass a mesh as the environment")
    return np.asarray(cloud.vertices), False, None


def _read_pcd(file: BinaryIO, path: Path) -> tuple[np.ndarray, bool, Float[np.ndarray, "3"] | None]:
    """Read a PCD of version 0.7: https://pointclouds.org/documentation/tutorials/pcd_file_format.html."""
    data = mmap(file.fileno(), 0, access=ACCESS_READ) if path.stat().st_size else b""  # read where it is used
    marker = data.find(b"\nDATA ", 0, PCD_HEADER)
    end = data.find(b"\n", marker + 1)
    header = {}
    for line in data[: end if marker >= 0 and end >= 0 else 0].decode("ascii", "replace").splitlines():
        words = line.split("#")[0].split()
        if words:
            header[words[0]] = words[1:]
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA") if not header.get(key)]
    if missing or not {"x", "y", "z"} <= set(header["FIELDS"]):
        what = f"no {missing[0]}" if missing else "no x, y, z among its FIELDS"
        raise SceneError(f"{path}: cannot be read as pcd ({what} in the header); {REMEDY}")
    fields, sizes = header["FIELDS"], [int(size) for size in header["SIZE"]]
    counts = [int(count) for count in header.get("COUNT", ["1"] * len(fields))]
    height, encoding = int(header["HEIGHT"][0]), header["DATA"][0]
    number = int(header["WIDTH"][0]) * height
    if not 0 <= number <= MAX_POINTS or not len(fields) == len(sizes) == len(counts) == len(header["TYPE"]):
        raise SceneError(
            f"{path}: a header of {number:,} points, {len(fields)} fields; expected at most {MAX_POINTS:,}"
        )
    if encoding == "ascii":
        columns = np.cumsum([0, *counts])
        table = np.array(data[end:].split(), dtype=np.float64).reshape(-1, columns[-1])
        points = np.stack([table[:, columns[fields.index(axis)]] for axis in "xyz"], axis=1)
    elif encoding == "binary":
        kinds = [PCD_TYPES[kind, size] for kind, size in zip(header["TYPE"], sizes, strict=True)]
        row = np.dtype([(f"{i}", kind, (count,)) for i, (kind, count) in enumerate(zip(kinds, counts, strict=True))])
        rows = np.frombuffer(data, dtype=row, count=number, offset=end + 1)
        points = np.concatenate([rows[f"{fields.index(axis)}"][:, :1].astype(np.float64) for axis in "xyz"], axis=1)
    else:
        raise SceneError(
            f"{path}: its DATA is {encoding}; expected ascii or binary; write it again with "
            "pcl_convert_pcd_ascii_binary IN.pcd OUT.pcd 1"
        )
    if len(points) != number:
        raise SceneError(f"{path}: {number:,} points announced, {len(points):,} read; {REMEDY}")
    place = np.array(header.get("VIEWPOINT", ["0"] * 7)[:3], dtype=np.float64)
    return points, height > 1, place if place.shape == (3,) and place.any() and np.isfinite(place).all() else None


READERS = {".npy": _read_npy, ".pcd": _read_pcd, ".ply": _read_ply}

MAX_VIEW_POINTS = 64
SAMPLED = 5_000  # points at which the density is measured
NEIGHBOURS = 8  # of a point, whose distance tells the density
# Spacings of points that a pixel is wide: nine of ten pixels of a surface hold a point, the rest is bridged.
PIXEL = 1.5
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
