"""Depth views as a folder that `load_views` reads: `cameras.json`, depth images and masks as PNG."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from dexnudge.errors import OutputError, SceneError, what_failed
from dexnudge.perception.depth_view import DepthView
from dexnudge.perception.views import CAMERAS_FILE

LARGEST_STEP = 2**16 - 1  # of a 16-bit image


def save_views(views: Sequence[DepthView], folder: str | Path, *, unit: float = 0.001) -> Path:
    """Write views into `folder`, made if need be; return the path of its `cameras.json`.

    unit: length of one step of the depth images [m]; depths are rounded to it.

    Raises:
        SceneError: a depth that 16 bits do not hold in this unit. OutputError: the folder cannot be written.
    """
    folder, entries = Path(folder), []
    try:
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
    except OSError as error:
        raise OutputError(
            f"{folder}: the views cannot be written ({what_failed(error)}); expected a folder that you may write to"
        ) from error
    return path
