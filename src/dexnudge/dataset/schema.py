"""What a row of a dataset is, how it lies in a Parquet file, and how its numbers are rounded.

Every pose is in the resting frame of its object, in metres and radians; see `RESTING_FRAME`. Each column of the Arrow
schema states its unit, its frame and its meaning.

Numbers are multiples of powers of two, so that what is verified is what is stored. A multiple of 2**-k is exact in
float32 and float64 as long as it is below 2**(24-k): nothing changes between the verification, the file and a reader. Its
trailing mantissa bits are zero, which makes Parquet files a good deal smaller.
"""

from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from dexnudge.errors import DatasetError

FORMAT_VERSION = 2  # raised whenever a column, a unit or a frame changes its meaning
BEHAVIOURS = ("grasp", "push", "press", "hook")  # a stored behaviour index points into this tuple
NUM_DIRECTIONS = 16  # planar directions of motion; direction k has the angle k * 22.5 degrees in the resting frame
TURNS = (
    *("turn +z", "turn -z"),
    *(f"{kind} {heading}" for kind in ("tip", "edge") for heading in ("+x", "+y", "-x", "-y")),
)  # motions about an axis: in place, over an edge of its own, over the edge of a table
INFEASIBLE = -1.0  # force margin of a motion in which no contact forces balance
CLOUD_POINTS = 1024  # surface points stored per object: enough for random subsets of 256
POSE_DIMENSIONS = 9  # translation (3) and 6D rotation (6) that come before the joint angles in q
RESTING_FRAME = "object at rest: z up, origin at the centroid of its convex hull (x, y) and half way up (z)"
_HOLD = "farthest that the object moves while a grasp holds it against forces from all sides; null for other behaviours"
_TURN = "farthest that the object turns while a grasp holds it against forces from all sides; null for other behaviours"
CLOUD_COLUMNS = ("px", "py", "pz", "nx", "ny", "nz")


@dataclass(frozen=True, kw_only=True)
class ConfigurationRow:
    """One kept hand configuration of one object; units, frames and meanings are those of `configuration_schema`."""

    behaviour: str
    q: Float[np.ndarray, " dimension"]
    direction_margin: Float[np.ndarray, " direction"]
    contact_links: tuple[str, ...]
    contact_points: Float[np.ndarray, "link 3"]
    digits: tuple[str, ...]
    penetration_object: float
    penetration_environment: float
    penetration_self: float
    seed: int
    hold_translation: float | None = None
    hold_rotation: float | None = None
    turn_margin: Float[np.ndarray, " turn"] | None = None


@dataclass(kw_only=True)
class BehaviourCounts:
    """What became of every attempt at one behaviour: attempted = kept + sum(rejected) + failed."""

    attempted: int = 0
    kept: int = 0
    failed: int = 0
    rejected: dict[str, int] = field(default_factory=dict)

    @property
    def accounted(self) -> int:
        """Attempts whose outcome is known."""
        return self.kept + self.failed + sum(self.rejected.values())

    def validate(self, behaviour: str) -> None:
        """Raise DatasetError when an attempt has vanished or was counted twice."""
        if self.accounted != self.attempted:
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
    """Return the columns of `shard-<object>.parquet` for a hand with `num_joints` joint angles.

    Metadata of each column: description, unit ("" for text, "1" for a number without unit), frame.
    """
    points = pa.list_(pa.list_(pa.float32(), 3))
    return pa.schema(
        [
            _column("object", pa.string(), "name of the object"),
            _column("behaviour", pa.string(), f"one of {', '.join(BEHAVIOURS)}"),
            _column(
                "q",
                pa.list_(pa.float32(), POSE_DIMENSIONS + num_joints),
                "hand configuration: root translation (3), first two columns of the root rotation (6), joint angles",
                unit="m (3), 1 (6), rad",
                frame=RESTING_FRAME,
            ),
            _column(
                "direction_margin",
                pa.list_(pa.float32(), NUM_DIRECTIONS),
                f"force margin while the object slides along direction k * {360 / NUM_DIRECTIONS:g} degrees about z, "
                f"rounded down; {INFEASIBLE:g} where no contact forces balance",
                unit="1",
                frame=RESTING_FRAME,
            ),
            _column("contact_links", pa.list_(pa.string()), "hand links that touch the object"),
            _column(
                "contact_points",
                points,
                "mean contact point of each of contact_links, on the object",
                unit="m",
                frame=RESTING_FRAME,
            ),
            _column("digits", pa.list_(pa.string()), "digits that touch the object"),
            _column("penetration_object", pa.float32(), "depth of the hand in the object", unit="m"),
            _column("penetration_environment", pa.float32(), "depth of the hand in the support plane", unit="m"),
            _column("penetration_self", pa.float32(), "depth of hand links in each other", unit="m"),
            _column("seed", pa.int64(), "seed of the run"),
            _column("hold_translation", pa.float32(), _HOLD, unit="m", nullable=True),
            _column("hold_rotation", pa.float32(), _TURN, unit="rad", nullable=True),
            _column(
                "turn_margin",
                pa.list_(pa.float32(), len(TURNS)),
                f"force margin as the object begins to turn about an axis: {', '.join(TURNS)}; rounded down; "
                f"{INFEASIBLE:g} where no contact forces balance, null in datasets from before it was judged",
                unit="1",
                frame=RESTING_FRAME,
                nullable=True,
            ),
        ]
    )


LATER_COLUMNS = ("turn_margin",)  # that older shards lack: read as null


def cloud_schema() -> pa.Schema:
    """Return the columns of `object-<object>.parquet`: surface points [m] and outward unit normals, resting frame."""
    return pa.schema(
        [
            _column(
                name,
                pa.float32(),
                f"{name[1]} of a surface point" if name[0] == "p" else f"{name[1]} of its outward unit normal",
                unit="m" if name[0] == "p" else "1",
                frame=RESTING_FRAME,
            )
            for name in CLOUD_COLUMNS
        ]
    )


def _column(
    name: str, kind: pa.DataType, description: str, *, unit: str = "", frame: str = "", nullable: bool = False
) -> pa.Field:
    return pa.field(name, kind, nullable=nullable, metadata={"description": description, "unit": unit, "frame": frame})


def direction_angles() -> Float[np.ndarray, " direction"]:
    """Return the angle of each planar direction about z in the resting frame [rad]."""
    return np.arange(NUM_DIRECTIONS) * (2.0 * np.pi / NUM_DIRECTIONS)


def best_direction(direction_margin: Float[np.ndarray, " direction"]) -> int:
    """Return the index of the greatest margin; among equals the one in the middle of the widest arc of them."""
    best = direction_margin == direction_margin.max()
    count = len(best)
    width = np.zeros(count, dtype=np.int64)  # of directions on either side that are as good
    for reach in range(1, count // 2 + 1):
        wider = np.all([np.roll(best, shift) for shift in range(-reach, reach + 1)], axis=0)
        width[wider] = reach
    return int(np.argmax(np.where(best, width, -1)))


TRANSLATION_STEP = 2.0**-15  # [m] 31 micrometres: a thirtieth of the penetration that is allowed
ROTATION_STEP = 2.0**-15  # rounded columns stay orthonormal to 6e-5, within the 1e-4 that a configuration may be off
JOINT_STEP = 2.0**-13  # [rad] 0.007 degrees; half of it lies within the 1e-4 rad that a limit may be off
SLIDE_STEP = 2.0**-17  # [m] of a sliding joint, 8 micrometres: the same of what counts as a radian, 0.05 m
MARGIN_STEP = 2.0**-10  # force margins have no unit; half of what a solver on another machine may differ by
POINT_STEP = 2.0**-16  # [m] 15 micrometres, on surfaces
NORMAL_STEP = 2.0**-10  # a twentieth of a degree

_ROTATION, _JOINTS = slice(3, 9), slice(9, None)  # places in q = [translation (3) | rotation columns (6) | joints]


def round_configuration(
    q: Float[np.ndarray, "*batch dimension"], *, sliding: Bool[np.ndarray, " joint"] | None = None
) -> Float[np.ndarray, "*batch dimension"]:
    """Return the nearest configurations that a dataset can store: call it before they are verified.

    q: [root translation (3) [m] | first two columns of the root rotation (6) | joint angles [rad]]; the
    entries of `sliding` joints are in metres, None: there are none. Rounding keeps the order of two joints, so a coupling
    that held still holds; a joint at its limit leaves it by at most 6.1e-5 rad, or 3.8e-6 m.
    Rounded twice is rounded once. The columns are no longer exactly orthonormal: every reader makes them so again.
    """
    rounded = round_to(q, TRANSLATION_STEP)
    rounded[..., _ROTATION] = round_to(q[..., _ROTATION], ROTATION_STEP)
    steps = JOINT_STEP if sliding is None else np.where(sliding, SLIDE_STEP, JOINT_STEP)
    rounded[..., _JOINTS] = round_to(q[..., _JOINTS], steps)
    return rounded


def floor_margin(margin: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Return the greatest force margins that a dataset can store and that do not exceed the true ones; 1 and -1 stay."""
    return np.floor(margin / MARGIN_STEP) * MARGIN_STEP


def round_cloud(cloud: Float[np.ndarray, "point 6"]) -> Float[np.ndarray, "point 6"]:
    """Return the nearest points [m] and normals that a dataset can store; normals are unit vectors to within 0.001."""
    return np.concatenate([round_to(cloud[:, :3], POINT_STEP), round_to(cloud[:, 3:], NORMAL_STEP)], axis=1)


def round_to(
    values: Float[np.ndarray, "*batch"], step: float | Float[np.ndarray, " column"]
) -> Float[np.ndarray, "*batch"]:
    """Return the nearest multiples of `step`, halves to even."""
    return np.rint(values / step) * step
