"""What a dataset holds, counted: behaviours, rejections, digits, directions, sides, and the spread of its numbers."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from dexnudge.dataset.all_rows import OCTANTS, SIDES, AllRows, gather_rows, palm_octants
from dexnudge.dataset.manifest import MANIFEST_NAME, Manifest, read_manifest
from dexnudge.dataset.schema import BEHAVIOURS, POSE_DIMENSIONS, BehaviourCounts
from dexnudge.dataset.shards import cloud_path, is_complete, read_shard, shard_path
from dexnudge.errors import HandError, UnknownNameError
from dexnudge.hands.registry import load_hand

BINS = 12  # about as many as a person takes in at a glance
ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)  # times a power of ten: widths that read well
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


@dataclass(frozen=True, kw_only=True)
class Histogram:
    """How often a quantity falls into each bin [edge k, edge k + 1); the last bin holds its upper edge too.

    counts: label of a group of rows -> rows per bin; quantiles: the same labels -> values at `QUANTILES`.
    """

    quantity: str
    unit: str
    edges: Float[np.ndarray, " edge"]
    counts: dict[str, Int[np.ndarray, " bin"]]
    quantiles: dict[str, Float[np.ndarray, " quantile"]]

    @property
    def title(self) -> str:
        """The quantity with its unit."""
        return f"{self.quantity} [{self.unit}]" if self.unit else self.quantity


def make_histogram(quantity: str, unit: str, values: dict[str, Float[np.ndarray, " n"]]) -> Histogram:
    """The histogram of finite values by group; groups without values are left out."""
    groups = {label: np.asarray(group, dtype=np.float64) for label, group in values.items() if len(group)}
    edges = round_edges(np.concatenate(list(groups.values()) or [np.zeros(1)]))
    return Histogram(
        quantity=quantity,
        unit=unit,
        edges=edges,
        counts={label: np.histogram(group, edges)[0] for label, group in groups.items()},
        quantiles={label: np.quantile(group, QUANTILES) for label, group in groups.items()},
    )


def round_edges(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " edge"]:
    """Edges at multiples of a round width that enclose all values in at most about `BINS` bins."""
    low, high = float(values.min()), float(values.max())
    wanted = max((high - low) / BINS, 1e-12 * max(abs(low), abs(high), 1.0))
    power = 10.0 ** np.floor(np.log10(wanted))
    width = power * min(factor for factor in ROUND if factor * power >= wanted * (1 - 1e-9))
    first, last = np.floor(low / width), np.ceil(high / width)
    # Products like 3 * 0.1 may fall a hair inside the outermost value.
    edges = np.arange(first, max(last, first + 1) + 1) * width
    edges[0], edges[-1] = min(edges[0], low), max(edges[-1], high)
    return edges


FEASIBLE_MARGIN = 1.0  # force margin from which a direction of motion counts as feasible
HOLD_DRIFT = "drift while held"  # name of the histogram over the rows that were held in simulation


@dataclass(frozen=True, kw_only=True)
class DatasetInfo:
    """Totals over a dataset folder.

    Attributes:
        manifest: of the folder.
        num_objects: with a shard. missing_objects: neither written nor failed.
        counts: behaviour -> what became of every attempt.
        digits_per_configuration: behaviour -> number of digits in contact -> rows.
        digit_use: behaviour -> digit -> rows.
        feasible_rows: (16) non-prehensile rows whose margin is >= 1 in direction k.
        objects_covered: (16) objects with at least one such row.
        side_rows: behaviour -> side of `SIDES` -> rows that touch it; a row may touch several.
        side_objects: side -> objects with a non-prehensile row that touches it.
        octant_rows: behaviour -> octant of `OCTANTS` -> rows whose palm stands there.
        histograms: of margin, penetration, height and drift.
        joint_angles: (d, 3) least, median and greatest angle of each joint [rad]; NaN without rows.
        joint_limits: (d, 2) [rad]; None when the hand that the manifest names cannot be loaded here.
        bytes_on_disk: of manifest and Parquet files. bytes_per_row: of the shards alone; 0 without rows.
    """

    manifest: Manifest
    num_objects: int
    missing_objects: int
    counts: dict[str, BehaviourCounts]
    digits_per_configuration: dict[str, dict[str, int]]
    digit_use: dict[str, dict[str, int]]
    feasible_rows: list[int]
    objects_covered: list[int]
    side_rows: dict[str, dict[str, int]]
    side_objects: dict[str, int]
    octant_rows: dict[str, dict[str, int]]
    histograms: tuple[Histogram, ...]
    joint_angles: Float[np.ndarray, "joint 3"]
    joint_limits: Float[np.ndarray, "joint 2"] | None
    bytes_on_disk: int
    bytes_per_row: float

    @property
    def num_configurations(self) -> int:
        """Kept rows over all behaviours."""
        return sum(count.kept for count in self.counts.values())


def describe(folder: Path | str) -> DatasetInfo:
    """Count what the shards of `folder` hold; raises DatasetError as `read_shard` does."""
    folder = Path(folder)
    manifest = read_manifest(folder)
    names = [name for name in sorted(manifest.objects) if is_complete(folder, name)]
    shards = [read_shard(folder, manifest, name) for name in names]
    rows = gather_rows(folder, manifest, shards)
    counts = {behaviour: BehaviourCounts() for behaviour in BEHAVIOURS}
    for shard in shards:
        for behaviour, count in shard.counts.items():
            counts[behaviour] += count
    feasible = rows.direction_margin >= FEASIBLE_MARGIN
    numbers = rows.digits.sum(axis=1)
    octants = palm_octants(rows.q[:, :3])
    shard_bytes = sum(shard_path(folder, name).stat().st_size for name in names)
    cloud_bytes = sum(cloud_path(folder, name).stat().st_size for name in names)
    return DatasetInfo(
        manifest=manifest,
        num_objects=len(names),
        missing_objects=len(set(manifest.objects) - set(names) - set(manifest.failed_objects)),
        counts=counts,
        digits_per_configuration=rows.by_behaviour(*_one_hot(numbers, range(len(manifest.joint_groups) + 1))),
        digit_use=rows.by_behaviour(rows.digits, tuple(manifest.joint_groups)),
        feasible_rows=feasible[rows.non_prehensile].sum(axis=0).tolist(),
        objects_covered=rows.objects_with(feasible),
        side_rows=rows.by_behaviour(rows.sides, SIDES),
        side_objects=dict(zip(SIDES, rows.objects_with(rows.sides), strict=True)),
        octant_rows=rows.by_behaviour(octants[:, None] == np.arange(len(OCTANTS)), OCTANTS),
        histograms=_histograms(rows),
        joint_angles=_spread(rows.q[:, POSE_DIMENSIONS:]),
        joint_limits=joint_limits(manifest),
        bytes_on_disk=shard_bytes + cloud_bytes + (folder / MANIFEST_NAME).stat().st_size,
        bytes_per_row=shard_bytes / len(rows.q) if len(rows.q) else 0.0,
    )


def joint_limits(manifest: Manifest) -> Float[np.ndarray, "joint 2"] | None:
    """Limits (d, 2) [rad] of the manifest's hand; None when it cannot be loaded here, or has other joints by now."""
    try:
        hand = load_hand(str(manifest.config.get("hand", manifest.hand)))
    except (HandError, UnknownNameError):  # counts can be read without the hand's files
        return None
    return np.stack([hand.lower, hand.upper], axis=1) if hand.joint_names == manifest.joint_names else None


def _histograms(rows: AllRows) -> tuple[Histogram, ...]:
    """Margin of the best direction, penetration, palm's height, and what a grasp drifted in the test of holding."""
    groups = {behaviour: rows.behaviour == behaviour for behaviour in BEHAVIOURS}
    pushed = {behaviour: which & rows.non_prehensile for behaviour, which in groups.items()}
    held = {behaviour: which & np.isfinite(rows.hold_translation) for behaviour, which in groups.items()}
    quantities = (
        ("force margin in the best direction", "", rows.direction_margin.max(axis=1, initial=-np.inf), pushed),
        ("deepest penetration", "mm", 1e3 * rows.penetration, groups),
        ("palm's origin above the object's middle", "mm", 1e3 * rows.q[:, 2], groups),
        (HOLD_DRIFT, "mm", 1e3 * rows.hold_translation, held),
        ("turn while held", "deg", np.degrees(rows.hold_rotation), held),
    )
    return tuple(
        make_histogram(name, unit, {behaviour: values[which] for behaviour, which in chosen.items()})
        for name, unit, values, chosen in quantities
        if any(which.any() for which in chosen.values())
    )


def _spread(angles: Float[np.ndarray, "row joint"]) -> Float[np.ndarray, "joint 3"]:
    if not len(angles):
        return np.full((angles.shape[1], 3), np.nan)
    return np.quantile(angles, [0.0, 0.5, 1.0], axis=0).T


def _one_hot(values: np.ndarray, kinds: range) -> tuple[Bool[np.ndarray, "row kind"], tuple[str, ...]]:
    return values[:, None] == np.asarray(kinds), tuple(map(str, kinds))
