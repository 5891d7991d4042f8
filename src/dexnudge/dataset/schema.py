"""What a dataset row is, and how it lies in a Parquet file.

Every pose is in the RESTING frame of its object: origin as in `geometry.frames.resting_origin`, z up, yaw as
the object's mesh is laid down. Metres and radians. A row holds q = [root translation (3) | first two COLUMNS of the root
rotation, stacked (6) | joint angles (d)], and for each of 16 planar directions of motion the force margin that the
configuration reaches there.
"""

from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from dexnudge.errors import DatasetError

FORMAT_VERSION = 1  # raised whenever a column, a unit or a frame changes its meaning
BEHAVIOURS = ("grasp", "push", "press", "hook")  # a stored behaviour index points into this tuple
NUM_DIRECTIONS = 16  # planar directions of motion; direction k has the angle k * 22.5 degrees in the resting frame
INFEASIBLE = -1.0  # force margin of a direction in which no contact forces balance
CLOUD_POINTS = 1024  # surface points stored per object: enough for random subsets of 256
POSE_DIMENSIONS = 9  # translation (3) and 6D rotation (6) that come before the joint angles in q
CLOUD_COLUMNS = ("px", "py", "pz", "nx", "ny", "nz")


@dataclass(frozen=True, kw_only=True)
class ConfigurationRow:
    """One kept hand configuration of one object.

    q: (9 + d) resting frame [m, rad]; direction_margin: (16) force margin while the object slides along direction k,
    `INFEASIBLE` where none exists (all of them for grasps); penetrations: depth >= 0 [m]; seed: the draw's own seed.
    """

    behaviour: str
    q: Float[np.ndarray, " dimension"]
    direction_margin: Float[np.ndarray, " direction"]
    contact_links: tuple[str, ...]
    digits: tuple[str, ...]
    penetration_object: float
    penetration_environment: float
    penetration_self: float
    seed: int


@dataclass(kw_only=True)
class BehaviourCounts:
    """What became of every attempt at one behaviour: attempted = kept + sum(rejected) + failed."""

    attempted: int = 0
    kept: int = 0
    failed: int = 0
    rejected: dict[str, int] = field(default_factory=dict)

    def validate(self, behaviour: str) -> None:
        """Raise DatasetError when an attempt has vanished or was counted twice."""
        accounted = self.kept + self.failed + sum(self.rejected.values())
        if accounted != self.attempted:
            raise DatasetError(
                f"counts of behaviour {behaviour!r} do not add up: expected attempted = kept + rejected + failed, got "
                f"{self.attempted} != {self.kept} + {sum(self.rejected.values())} + {self.failed}; "
                "count every attempt exactly once."
            )

    def __add__(self, other: "BehaviourCounts") -> "BehaviourCounts":
        reasons = sorted(set(self.rejected) | set(other.rejected))
        return BehaviourCounts(
            attempted=self.attempted + other.attempted,
            kept=self.kept + other.kept,
            failed=self.failed + other.failed,
            rejected={reason: self.rejected.get(reason, 0) + other.rejected.get(reason, 0) for reason in reasons},
        )


def configuration_schema(num_joints: int) -> pa.Schema:
    """Columns of `shard-<object>.parquet` for a hand with `num_joints` joint angles."""
    return pa.schema(
        [
            pa.field("object", pa.string(), nullable=False),
            pa.field("behaviour", pa.string(), nullable=False),
            pa.field("q", pa.list_(pa.float32(), POSE_DIMENSIONS + num_joints), nullable=False),
            pa.field("direction_margin", pa.list_(pa.float32(), NUM_DIRECTIONS), nullable=False),
            pa.field("contact_links", pa.list_(pa.string()), nullable=False),
            pa.field("digits", pa.list_(pa.string()), nullable=False),
            pa.field("penetration_object", pa.float32(), nullable=False),
            pa.field("penetration_environment", pa.float32(), nullable=False),
            pa.field("penetration_self", pa.float32(), nullable=False),
            pa.field("seed", pa.int64(), nullable=False),
        ]
    )


def cloud_schema() -> pa.Schema:
    """Columns of `object-<object>.parquet`: surface points [m] and outward unit normals, resting frame."""
    return pa.schema([pa.field(name, pa.float32(), nullable=False) for name in CLOUD_COLUMNS])


def direction_angles() -> Float[np.ndarray, " direction"]:
    """Angle of each planar direction about z in the resting frame [rad]."""
    return np.arange(NUM_DIRECTIONS) * (2.0 * np.pi / NUM_DIRECTIONS)
