"""Depth views as others hand them over: a folder with `cameras.json`, or a sequence."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool
from PIL import Image

from dexnudge.errors import SceneError, check_kind, check_path, quote, what_failed, writing
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.jobs.json_files import path_inside, read_json
from dexnudge.perception.depth_view import MAX_PIXELS, UNSCALED, DepthView, finite_number, read_depth, read_mask
from dexnudge.perception.point_cloud import FORMATS, cloud_views

__all__ = ["DepthView", "load_views"]

CAMERAS_FILE = "cameras.json"
NUMBER_OF_VIEW = re.compile(r"\{(?::0\dd?)?\}")  # in names of masks: {}, or {:03} for numbers with leading zeros
NUMBERS = ("fx", "fy", "cx", "cy", "depth_unit")
LARGEST_UNIT = 1.0  # [m] of one step of depth
MAX_VIEWS = 256
MAX_ALL_PIXELS = 256_000_000  # of all views: a gigabyte of depth in single precision


def load_views(
    source: str | Path | Sequence[DepthView], *, masks: str | None = None, view_points: Any = None
) -> list[DepthView]:
    """Return the views of a folder with `cameras.json`, of that file, of a point cloud, or of a sequence.

    `cameras.json` is a list, an entry a view: `depth` (16-bit PNG inside the folder), `depth_unit` [m], `width`, `height`,
    `fx`, `fy`, `cx`, `cy` [px], `T_world_camera`, and optionally `mask` (PNG, not zero = object; a view without the object
    has none).

    `masks` names the object's masks in place of `mask`, where a folder holds those of several: `"box_{}.png"` with {} for
    the number of the view, from 0. Such a mask may be empty, or missing, in views that do not see the object.

    A point cloud (`.ply`, `.pcd`, `.npy`) needs `view_points`, where the sensor stood; see `cloud_views`.

    Raises:
        SceneError: a file is missing, damaged, outside the folder or of another kind, a key is missing, or a value is no
            camera's; it names file and view.
    """
    if isinstance(source, str | Path):
        check_path("views", source, SceneError)
        if Path(source).suffix.lower() in FORMATS:
            if masks is not None:
                raise SceneError(
                    f"`masks` is {quote(masks)}, but {source} is a point cloud, which has no pixels; leave it out"
                )
            return cloud_views(source, view_points)
    if view_points is not None:
        raise SceneError(
            "`view_points` is given without a point cloud; expected them with .ply, .pcd or .npy; leave it out"
        )
    if isinstance(source, str | Path):
        return _read_views(Path(source), masks)
    views: Sequence[Any] = source
    if masks is not None:
        raise SceneError("`masks` names files of a folder, but `views` is a sequence; expected masks in the views")
    if not isinstance(views, Sequence):
        raise SceneError(f"`views` is a {type(views).__name__}; expected a folder, a {CAMERAS_FILE}, or DepthViews")
    _check_count("`views`", len(views))
    for view in views:
        check_kind("views", view, DepthView, "dn.DepthView(depth, fx, fy, cx, cy, T_world_camera)")
    return list(views)


def _read_views(path: Path, masks: str | None) -> list[DepthView]:
    try:
        path = path / CAMERAS_FILE if path.is_dir() else path
    except OSError as error:  # a name of 300 letters
        raise SceneError(f"{path}: {what_failed(error)}; expected a folder or a {CAMERAS_FILE}") from error
    content = read_json(path)
    if not isinstance(content, list):
        raise SceneError(f"{path}: holds a JSON {type(content).__name__}; expected a list with an entry for each view")
    _check_count(str(path), len(content))
    if masks is not None and (not isinstance(masks, str) or len(NUMBER_OF_VIEW.findall(masks)) != 1):
        raise SceneError(
            f"`masks` is {quote(masks)}; expected a name with {{}} for the number of the view: box_{{}}.png"
        )
    views: list[DepthView] = []
    for index, entry in enumerate(content):
        views.append(_read_view(path, index, entry, masks))
        if (pixels := sum(view.depth.size for view in views)) > MAX_ALL_PIXELS:
            raise SceneError(f"{path}: {pixels:,} pixels up to view {index}; expected at most {MAX_ALL_PIXELS:,}")
    if masks is not None and not any(view.mask is not None and view.mask.any() for view in views):
        raise SceneError(f"{path.parent / masks}: no view's mask has a pixel; expected the object in one at least")
    return views


def _read_view(path: Path, index: int, entry: Any, masks: str | None) -> DepthView:
    name = f"{path}: view {index}"
    if not isinstance(entry, dict):
        raise SceneError(f"{name} is a JSON {type(entry).__name__}; expected an object with named values")
    required = ("depth", *NUMBERS, "width", "height", "T_world_camera")
    for key in required:
        if key not in entry:
            raise SceneError(f"{name}: the key {key!r} is missing; expected {', '.join(required)}")
    for key in ("width", "height"):
        if (value := finite_number(entry[key], f"{name}: {key}")) != int(value) or value < 1:
            raise SceneError(f"{name}: {key} is {quote(entry[key])}; expected a whole number of pixels, at least 1")
    width, height = int(entry["width"]), int(entry["height"])
    if width * height > MAX_PIXELS:
        raise SceneError(
            f"{name}: has {quote(width)} x {quote(height)} pixels; expected at most {MAX_PIXELS:,}; scale it down"
        )
    fx, fy, cx, cy, unit = (finite_number(entry[key], f"{name}: {key}") for key in NUMBERS)
    if not 0 < unit <= LARGEST_UNIT:
        raise SceneError(
            f"{name}: depth_unit is {unit:g}; expected the metres of one step, such as 0.001 for millimetres"
        )
    pose = entry["T_world_camera"]
    for number in np.ravel(np.array(pose, dtype=object)):
        finite_number(number, f"{name}: T_world_camera: a value")
    try:
        pose = rigid_transform(pose, "T_world_camera", unscaled=UNSCALED)
        file = path_inside(path.parent, entry["depth"], "depth", file=path.name, what="image")
        depth = read_depth(file, width=width, height=height)
        mask = _read_mask(path, index, entry, masks, width=width, height=height)
    except (SceneError, OSError) as error:
        raise SceneError(f"{name}: {error}") from error
    return DepthView(depth * unit, fx, fy, cx, cy, T_world_camera=pose, mask=mask, name=name)


def _read_mask(
    path: Path, index: int, entry: dict[str, Any], masks: str | None, *, width: int, height: int
) -> Bool[np.ndarray, "height width"] | None:
    if masks is None and entry.get("mask") is None:
        return None
    value = entry["mask"] if masks is None else NUMBER_OF_VIEW.sub(lambda found: found[0].format(index), masks)
    file = path_inside(path.parent, value, "mask" if masks is None else "`masks`", file=path.name, what="image")
    if masks is not None and not file.exists():
        return None
    mask = read_mask(file, width=width, height=height)
    if masks is None and not mask.any():
        raise SceneError(f"{file}: the mask has no pixel; expected the object's; leave out `mask` where it is not seen")
    return mask


def _check_count(where: str, count: int) -> None:
    if not 1 <= count <= MAX_VIEWS:
        raise SceneError(f"{where}: {count} views; expected 1 to {MAX_VIEWS}")


LARGEST_STEP = 2**16 - 1  # of a 16-bit image


def save_views(views: Sequence[DepthView], folder: str | Path, *, unit: float = 0.001) -> Path:
    """Write views into `folder`, made if need be; return the path of its `cameras.json`.

    unit: length of one step of the depth images [m]; depths are rounded to it.

    Raises:
        SceneError: a depth that 16 bits do not hold in this unit. OutputError: the folder cannot be written.
    """
    folder, entries = Path(folder), []
    with writing(f"the views into {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        for index, view in enumerate(views):
            steps = np.rint(view.depth / unit)
            if steps.max() > LARGEST_STEP:
                raise SceneError(
                    f"{view.name}: a depth of {view.depth.max():.3g} m is more than {LARGEST_STEP} steps of {unit:g} m; "
                    "expected depths that 16 bits hold; use a larger `unit`"
                )
            entry = {
                "depth": f"depth_{index}.png",
                "depth_unit": unit,
                **{name: getattr(view, name) for name in ("fx", "fy", "cx", "cy", "width", "height")},
                "T_world_camera": view.T_world_camera.tolist(),
            }
            Image.fromarray(steps.astype(np.uint16)).save(folder / entry["depth"])
            if view.mask is not None and view.mask.any():
                entry["mask"] = f"mask_{index}.png"
                Image.fromarray(np.where(view.mask, np.uint8(255), np.uint8(0))).save(folder / entry["mask"])
            entries.append(entry)
        path = folder / CAMERAS_FILE
        path.write_text(json.dumps(entries, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return path
