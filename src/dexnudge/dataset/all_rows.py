"""The rows of all objects of a dataset, side by side, with what is counted of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.schema import BEHAVIOURS, NUM_DIRECTIONS, POSE_DIMENSIONS
from dexnudge.dataset.shards import Shard, read_cloud
from dexnudge.dataset.sides import SIDES, contact_sides

PENETRATIONS = ("penetration_object", "penetration_environment", "penetration_self")
GRASP = "grasp"


@dataclass(frozen=True, kw_only=True)
class AllRows:
    """Columns over the rows of all objects.

    behaviour: name; object_index: into the shards; q: (n, 9 + d) resting frame [m, rad]; direction_margin: (n, 16);
    penetration: deepest of object, surroundings and hand itself [m]; digits: those in contact; sides: which of `SIDES`
    are touched; hold_translation [m], hold_rotation [rad]: NaN where a row has none.
    """

    behaviour: np.ndarray
    object_index: Int[np.ndarray, " row"]
    q: Float[np.ndarray, "row dimension"]
    direction_margin: Float[np.ndarray, "row direction"]
    penetration: Float[np.ndarray, " row"]
    digits: Bool[np.ndarray, "row digit"]
    sides: Bool[np.ndarray, "row side"]
    hold_translation: Float[np.ndarray, " row"]
    hold_rotation: Float[np.ndarray, " row"]

    @property
    def non_prehensile(self) -> Bool[np.ndarray, " row"]:
        """Which rows push, press or hook."""
        return self.behaviour != GRASP

    def by_behaviour(self, member: Bool[np.ndarray, "row kind"], kinds: tuple[str, ...]) -> dict[str, dict[str, int]]:
        """Behaviour -> kind -> rows that are of this kind."""
        return {
            behaviour: dict(zip(kinds, member[self.behaviour == behaviour].sum(axis=0).tolist(), strict=True))
            for behaviour in BEHAVIOURS
        }

    def objects_with(self, member: Bool[np.ndarray, "row kind"]) -> list[int]:
        """For each kind, the number of objects that have a non-prehensile row of it."""
        chosen = self.non_prehensile
        return [len(np.unique(self.object_index[chosen & column])) for column in member.T]


def gather_rows(folder: Path, manifest: Manifest, shards: list[Shard]) -> AllRows:
    """Put the rows of all shards side by side; raises DatasetError as `read_cloud` does."""
    dimension = POSE_DIMENSIONS + len(manifest.joint_names)
    columns = [_columns(shard, read_cloud(folder, manifest, shard.object_name), manifest) for shard in shards]
    empty = {
        "behaviour": np.zeros(0, dtype=str),
        "q": np.zeros((0, dimension)),
        "direction_margin": np.zeros((0, NUM_DIRECTIONS)),
        "penetration": np.zeros(0),
        "digits": np.zeros((0, len(manifest.digit_joints)), dtype=bool),
        "sides": np.zeros((0, len(SIDES)), dtype=bool),
        "hold_translation": np.zeros(0),
        "hold_rotation": np.zeros(0),
    }
    joined = {name: np.concatenate([start, *(each[name] for each in columns)]) for name, start in empty.items()}
    lengths = [shard.table.num_rows for shard in shards]
    return AllRows(object_index=np.repeat(np.arange(len(shards)), lengths), **joined)


def _columns(shard: Shard, cloud: Float[np.ndarray, "point 6"], manifest: Manifest) -> dict[str, np.ndarray]:
    table = shard.table
    count = table.num_rows
    digits = np.zeros((count, len(manifest.digit_joints)), dtype=bool)
    place = {digit: index for index, digit in enumerate(manifest.digit_joints)}
    for row, used in enumerate(table.column("digits").to_pylist()):
        digits[row, [place[digit] for digit in used]] = True
    points, row_of_point = contact_points(table)
    sides = np.zeros((count, len(SIDES)), dtype=bool)
    sides[row_of_point, contact_sides(points, cloud)] = True
    return {
        "behaviour": np.array(table.column("behaviour").to_pylist(), dtype=str),
        "q": shard.column_matrix("q"),
        "direction_margin": shard.column_matrix("direction_margin"),
        "penetration": np.max([table.column(name).to_numpy() for name in PENETRATIONS], axis=0),
        "digits": digits,
        "sides": sides,
        "hold_translation": table.column("hold_translation").to_numpy().astype(np.float64),
        "hold_rotation": table.column("hold_rotation").to_numpy().astype(np.float64),
    }


def contact_points(table: pa.Table) -> tuple[Float[np.ndarray, "contact 3"], Int[np.ndarray, " contact"]]:
    """(points [m] in the resting frame, the row that each belongs to) of all contacts of a shard."""
    lists = table.column("contact_points").combine_chunks()
    lengths = np.diff(lists.offsets.to_numpy())
    points = lists.flatten().flatten().to_numpy(zero_copy_only=False).reshape(-1, 3)
    return points.astype(np.float64), np.repeat(np.arange(len(lists)), lengths)
