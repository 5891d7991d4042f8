"""Point clouds out of files: `.ply` without faces, `.pcd`, `.npy`."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import SceneError, check_path, what_failed
from dexnudge.geometry.mesh_files import PARSE_ERRORS

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
        data = b"" if kind == ".npy" else path.read_bytes()  # numpy maps its own file
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({what_failed(error)}); expected a point cloud") from error
    reader = {".ply": _read_ply, ".pcd": _read_pcd, ".npy": _read_npy}[kind]
    try:
        with np.errstate(all="ignore"):
            points, organised, view_point = reader(data, path)
            points = points.astype(np.float64) if points.dtype.kind in "fiu" else points
    except (*PARSE_ERRORS, TokenError, MemoryError, OSError) as error:
        if isinstance(error, SceneError):
            raise
        what = "the memory does not suffice" if isinstance(error, MemoryError | OSError) else type(error).__name__
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


def _read_npy(_: bytes, path: Path) -> tuple[np.ndarray, bool, None]:
    values = np.load(path, mmap_mode="r", allow_pickle=False)  # compares what is announced with the file's size first
    if values.ndim not in (2, 3) or values.shape[-1] not in (3, 6):
        raise SceneError(f"{path}: has shape {values.shape}; expected (n, 3), (n, 6) or (height, width, 3)")
    return values.reshape(-1, values.shape[-1])[:, :3], values.ndim == 3, None


def _read_ply(data: bytes, path: Path) -> tuple[np.ndarray, bool, None]:
    cloud = trimesh.load(io.BytesIO(data), file_type="ply", process=False)
    if not isinstance(cloud, trimesh.PointCloud):
        raise SceneError(f"{path}: has faces; expected a point cloud; pass a mesh as the environment")
    return np.asarray(cloud.vertices), False, None


def _read_pcd(data: bytes, path: Path) -> tuple[np.ndarray, bool, Float[np.ndarray, "3"] | None]:
    """Read a PCD of version 0.7: https://pointclouds.org/documentation/tutorials/pcd_file_format.html."""
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
