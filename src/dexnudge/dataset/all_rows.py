"""The rows of all objects of a dataset, side by side, with what is counted of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from dexnudge.dataset.manifest import Manifest
from dexnudge.dataset.schema import BEHAVIOURS, NUM_DIRECTIONS, POSE_DIMENSIONS
from dexnudge.dataset.shards import Shard, read_cloud

SIDES = ("top", "+x", "-x", "+y", "-y", "bottom")  # an index of a side points into this tuple
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], dtype=np.float64)
OCTANTS = ("+x", "+x+y", "+y", "-x+y", "-x", "-x-y", "-y", "+x-y")  # 45 degrees each, counter-clockwise, about an axis
NEIGHBOURS = 32  # stored surface points that may lie on the contact's own face; the nearest may lie round an edge
NEARNESS = 0.1  # weight of a point's distance against the distance of its tangent plane


def surface_normals(points: Float[np.ndarray, "n 3"], cloud: Float[np.ndarray, "point 6"]) -> Float[np.ndarray, "n 3"]:
    """Outward unit normal of the object at points of its surface [m], from stored surface points with normals.

    Each takes the normal of the neighbour c whose tangent plane it lies on: the least |n_c (p - c)| + 0.1 |p - c|.
    """
    neighbours = min(NEIGHBOURS, len(cloud))
    distance, index = cKDTree(cloud[:, :3]).query(points, k=[*range(1, neighbours + 1)])
    normals = cloud[index, 3:]
    off_plane = np.abs(np.einsum("nki,nki->nk", normals, points[:, None] - cloud[index, :3]))
    best = np.argmin(off_plane + NEARNESS * distance, axis=1)
    return normals[np.arange(len(points)), best]


def contact_faces(points: Float[np.ndarray, "n 3"], cloud: Float[np.ndarray, "point 6"]) -> Int[np.ndarray, " n"]:
    """Index into `SIDES` of the direction that is closest to the surface's normal at each contact point [m]."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    return np.argmax(surface_normals(points, cloud) @ NORMALS.T, axis=1)


def palm_octants(translation: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Index into `OCTANTS` of the azimuth at which the palm's origin stands around the object's centre."""
    azimuth = np.arctan2(translation[:, 1], translation[:, 0])
    return np.rint(azimuth / (np.pi / 4)).astype(np.int64) % len(OCTANTS)


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
        "digits": np.zeros((0, len(manifest.joint_groups)), dtype=bool),
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
    digits = np.zeros((count, len(manifest.joint_groups)), dtype=bool)
    place = {digit: index for index, digit in enumerate(manifest.joint_groups)}
    for row, used in enumerate(table.column("digits").to_pylist()):
        digits[row, [place[digit] for digit in used]] = True
    points, row_of_point = contact_points(table)
    sides = np.zeros((count, len(SIDES)), dtype=bool)
    sides[row_of_point, contact_faces(points, cloud)] = True
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
