"""Where an arm may stand: a map of places around an object by the share of configurations that it reaches from there."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter

from dexnudge.arms.arm import Arm
from dexnudge.arms.inverse_kinematics import InverseKinematics
from dexnudge.arms.standing import DEEPEST, standing_depth
from dexnudge.errors import InputError, OutputError, check_kind, check_path, writing
from dexnudge.geometry.devices import own_modes
from dexnudge.hands.batch import HandBatch
from dexnudge.jobs.folders import new_folder
from dexnudge.planning.reach import LEAST_MARGIN, STARTS, Reach, arm_margins, flange_ways
from dexnudge.results.samples import Samples
from dexnudge.scenes.scene import Scene
from dexnudge.viewer.base_picture import base_picture
from dexnudge.viewer.picture import check_png

EXTENT = 0.9  # [m] of the map from the object, either way along x and y
STEP = 0.1  # [m] from a place to the next
FARTHEST = 10.0  # [m] from the object; no arm reaches that far
MOST_PLACES = 20_000  # of a map: ten minutes
MOST = 16  # configurations that are tried, the best: more of them change a share by a few percent
FEW_STARTS = 2  # of inverse kinematics at first: what they reach needs no more
SLACK = 0.01  # [m] beyond the arm's reach, which is searched for
NEAREST = 0.05  # [m] of the base from the object's middle: nearer, it has no direction to face
DPI = 100  # of the picture
ARRAYS, BASE, PICTURE = "base_map.npz", "arm_base.json", "base_map.png"


@dataclass(frozen=True, eq=False, repr=False)
class BaseMap:
    """Shares of configurations that an arm can execute, by where it stands; facing the object, upright.

    Attributes:
        scene: what it stands around.
        arm: name of the arm.
        x, y: of the base [m, world]. heights: over the object's underside [m].
        share: of the configurations that are reachable along the motion, see `Reach`; NaN where the base stands in the
            surroundings.
        margin: mean of their margins, 0 for what is out of reach; NaN likewise.
        tried: how many configurations.
    """

    scene: Scene
    arm: str
    x: Float[np.ndarray, " column"]
    y: Float[np.ndarray, " row"]
    heights: Float[np.ndarray, " height"]
    share: Float[np.ndarray, "height row column"]
    margin: Float[np.ndarray, "height row column"]
    tried: int

    def pose(self, height: int, row: int, column: int) -> Float[np.ndarray, "4 4"]:
        """Return T_world_base of a place."""
        return _facing(self.scene, self.x[column], self.y[row], self.heights[height])

    def best(self, count: int = 1) -> list[tuple[int, int, int]]:
        """Return the best places as (height, row, column), none that reaches nothing.

        By the mean share of a place and the eight around it, as an arm is not put down to the centimetre, and wants room
        for its links; then by its own share and margin.
        """
        share, margin = np.nan_to_num(self.share), np.nan_to_num(self.margin).ravel()
        around = uniform_filter(share, size=(1, 3, 3), mode="constant").round(6).ravel()
        share = share.ravel()
        order = np.lexsort([-margin, -share, np.where(share > 0, -around, 0.0)])[:count]
        height, row, column = np.unravel_index(order[share[order] > 0], self.share.shape)
        return list(zip(height.tolist(), row.tolist(), column.tolist(), strict=True))

    @property
    def T_world_base(self) -> Float[np.ndarray, "4 4"]:
        """The best place.

        Raises:
            InputError: there is none.
        """
        best = self.best()
        if not best:
            raise InputError(
                f"'{self.arm}' reaches none of {self.tried} configurations from any place; expected one to reach some; try "
                "other `heights` or another `mount`"
            )
        return self.pose(*best[0])

    def picture(self, path: Path | str) -> Path:
        """Write the map as PNG, seen from above.

        Raises:
            InputError: a path that does not end in .png, or no matplotlib. OutputError: the file cannot be written.
        """
        check_png(path)
        best = next(iter(self.best()), None)
        figure = base_picture(self.scene, self.x, self.y, self.heights, self.share, best, self.arm)
        with writing(f"the picture {path}"):
            figure.savefig(path, dpi=DPI, metadata={"Software": None})
        return Path(path)

    def save(self, out: Path | str, *, overwrite: bool = False) -> None:
        """Write base_map.npz, base_map.png (with matplotlib) and, of the best place, arm_base.json into a new folder.

        Raises:
            OutputError: `out` exists without `overwrite`, is no map's folder, or cannot be written.
        """
        check_path("out", out, OutputError)
        with map_folder(out, overwrite=overwrite) as folder:
            self.write(folder)

    def write(self, folder: Path) -> None:
        """Write the same into an empty folder."""
        arrays = {name: getattr(self, name) for name in ("x", "y", "heights", "share", "margin")}
        np.savez_compressed(folder / ARRAYS, **arrays)
        if find_spec("matplotlib"):
            self.picture(folder / PICTURE)
        if self.best():
            content = {"arm": self.arm, "T_world_base": self.T_world_base.tolist()}
            (folder / BASE).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")

    def __repr__(self) -> str:
        free, best = np.isfinite(self.share), self.best()
        said = f"BaseMap of '{self.arm}': {int(free.sum())} of {free.size} places are free"
        if not best:
            return f"{said}; none reaches any of {self.tried} configurations"
        place = ", ".join(f"{value:.2f}" for value in self.pose(*best[0])[:3, 3])
        return f"{said}; the best, ({place}), reaches {self.share[best[0]]:.0%} of {self.tried} configurations"


def map_folder(out: Path | str, *, overwrite: bool) -> AbstractContextManager[Path]:
    """Own a new folder for a map; see `new_folder`."""
    return new_folder(out, overwrite=overwrite, marker=ARRAYS, ours=(BASE, PICTURE))


@own_modes()
def find_base(
    samples: Samples,
    arm: Arm,
    *,
    mount: Any = None,
    heights: Sequence[float] = (0.0,),
    extent: float = EXTENT,
    step: float = STEP,
    on_progress: Callable[[int, int], None] | None = None,
) -> BaseMap:
    """Return from where an arm reaches the best 16 verified samples along the motion.

    Args:
        samples: of one scene; reach from where they were judged by it does not count.
        arm: wherever it stands.
        mount: T_flange_mount, see `Reach`.
        heights: of the base over the object's underside [m].
        extent: of the map from the object's middle, along x and y [m].
        step: from one place to the next [m].
        on_progress: called with (places done, places).

    Raises:
        InputError: no samples that are verified but for reach, or numbers that make no map.
    """
    check_kind("samples", samples, Samples, 'load_samples("out")')
    kept = samples.success | (np.array(samples.reasons) == Reach.name)
    rows, high = np.flatnonzero(kept)[:MOST], np.asarray(heights, dtype=float)
    if not len(rows):
        raise InputError(
            "none of the samples is verified, so nothing is to be reached; expected at least one; draw more"
        )
    if not (0 < step <= extent <= FARTHEST) or high.ndim != 1 or not len(high) or not np.isfinite(high).all():
        raise InputError(
            f"no map of `extent` {extent}, `step` {step} and `heights` {heights}; expected 0 < step <= extent and at most "
            f"{FARTHEST:g} m"
        )
    if len(high) * (2 * int(extent / step) + 1) ** 2 > MOST_PLACES:
        raise InputError(
            f"a map of `extent` {extent:g} m, `step` {step:g} m and {len(high)} heights has too many places; expected "
            f"at most {MOST_PLACES:,}; give a longer `step`"
        )
    scene, reach = samples.scene, Reach(arm, mount=mount)
    hands = HandBatch(samples.hand, torch.as_tensor(samples.q[rows].astype(np.float64)), dense=True)
    ways = flange_ways(reach.robot(samples.hand), hands, scene)
    middle = scene.object_in_world().bounds.mean(axis=0)
    offsets = step * np.arange(-int(extent / step), int(extent / step) + 1)
    x, y = middle[0] + offsets, middle[1] + offsets
    share = np.full((len(high), len(y), len(x)), np.nan)
    margin = share.copy()
    for done, (height, row) in enumerate(np.ndindex(share.shape[:2])):
        poses = np.array([_facing(scene, each, y[row], high[height]) for each in x])
        free = [standing_depth(arm.standing_at(pose), scene)[0] <= DEEPEST for pose in poses]
        if any(free):
            T_base_world = np.linalg.inv(poses[free])[:, None, None]
            before, after = ((T_base_world @ way).reshape(-1, *way.shape[1:]) for way in ways)
            found = _margins(reach, scene, np.repeat(poses[free], len(rows), axis=0), before, after)
            found = found.reshape(-1, len(rows))
            share[height, row, free], margin[height, row, free] = (
                (found >= LEAST_MARGIN).mean(axis=1),
                found.mean(axis=1),
            )
        if on_progress:
            on_progress((done + 1) * len(x), share.size)
    return BaseMap(scene, arm.name, x, y, high, share, margin, len(rows))


def _margins(
    reach: Reach,
    scene: Scene,
    bases: Float[np.ndarray, "way 4 4"],
    before: Float[np.ndarray, "way early 4 4"],
    after: Float[np.ndarray, "way late 4 4"],
) -> Float[np.ndarray, " way"]:
    """Return the margins of ways in the frames of their bases.

    Of those out of the arm's length without inverse kinematics, of most others with few starts.
    """
    margin, kinematics = np.zeros(len(after)), InverseKinematics(reach.arm.standing_at(np.eye(4)))
    farthest = np.linalg.norm(after[:, :, :3, 3], axis=2).max(axis=1)
    left = np.flatnonzero(farthest <= reach.arm.reach + SLACK)
    for starts in (FEW_STARTS, STARTS):

        def blocked(
            positions: Float[np.ndarray, "row n"], way: Int[np.ndarray, " row"], own: Int[np.ndarray, " left"] = left
        ) -> Bool[np.ndarray, " row"]:
            return reach.blocked(scene, positions, bases[own[way]])

        margin[left] = arm_margins(kinematics, before[left], after[left], starts=starts, blocked=blocked).margin
        left = left[margin[left] < LEAST_MARGIN]
    return margin


def _facing(scene: Scene, x: float, y: float, height: float) -> Float[np.ndarray, "4 4"]:
    """Return T_world_base at a place, upright, its x-axis towards the object."""
    bounds = scene.object_in_world().bounds
    way = bounds.mean(axis=0)[:2] - (x, y)
    way = way / np.linalg.norm(way) if np.linalg.norm(way) > NEAREST else np.array([1.0, 0.0])
    pose = np.eye(4)
    pose[:2, 0], pose[:2, 1] = way, (-way[1], way[0])
    pose[:3, 3] = x, y, bounds[0, 2] + height
    return pose
