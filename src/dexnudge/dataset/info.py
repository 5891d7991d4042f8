"""What a dataset holds, counted: behaviours, rejections, digits, directions, contact faces, and how its numbers spread."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from dexnudge.dataset.document import Cell, Table
from dexnudge.dataset.manifest import MANIFEST_NAME, Manifest, read_manifest
from dexnudge.dataset.schema import (
    BEHAVIOURS,
    POSE_DIMENSIONS,
    TURNS,
    BehaviourCounts,
    configuration_schema,
    direction_angles,
)
from dexnudge.dataset.shards import (
    Shard,
    cloud_path,
    column_matrix,
    complete_objects,
    read_cloud,
    read_shard,
    shard_path,
)
from dexnudge.errors import HandError, UnknownNameError
from dexnudge.hands.hand import Hand

# Of an object at rest, by the direction that its normal is closest to.
FACES = ("top", "+x", "-x", "+y", "-y", "bottom")
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], dtype=np.float64)
OCTANTS = ("+x", "+x+y", "+y", "-x+y", "-x", "-x-y", "-y", "+x-y")  # 45 degrees each, counter-clockwise, about an axis
NEIGHBOURS = 32  # stored surface points that may lie on the contact's own face; the nearest may lie round an edge
NEARNESS = 0.1  # weight of a point's distance against the distance of its tangent plane
FEASIBLE_MARGIN = 1.0  # force margin from which a direction of motion counts as feasible
BINS = 12  # of a histogram: about as many as a person takes in at a glance
ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)  # times a power of ten: bin widths that read well
QUANTILES = {"least": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "greatest": 1.0}
PENETRATIONS = ("penetration_object", "penetration_environment", "penetration_self")


@dataclass(frozen=True, kw_only=True)
class DatasetInfo:
    """Totals over a dataset folder.

    Attributes:
        manifest: of the folder.
        num_objects: with a shard. missing_objects: neither written nor failed.
        counts: behaviour -> what became of every attempt. num_held: grasps that were held in simulation.
        tables: by name: `counts`, `digit_numbers`, `digits`, `directions`, `faces`, `face_objects`, `octants`, `joints`,
            and where there are rows `NAME_bins` and `NAME` (quantiles) for `margin`, `penetration`, `height`, `drift`,
            `turn`; `turns` where they were judged.
        bytes_on_disk: of manifest and Parquet files. bytes_per_row: of the shards alone; 0 without rows.
    """

    manifest: Manifest
    num_objects: int
    missing_objects: int
    counts: dict[str, BehaviourCounts]
    num_held: int
    tables: dict[str, Table]
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
    names = complete_objects(folder, manifest)
    shards = [read_shard(folder, manifest, name) for name in names]
    counts = {behaviour: BehaviourCounts() for behaviour in BEHAVIOURS}
    for shard in shards:
        for behaviour, count in shard.counts.items():
            counts[behaviour] += count
    empty = configuration_schema(len(manifest.joint_names)).empty_table()
    tables = [empty, *(shard.table.replace_schema_metadata() for shard in shards)]
    rows = pa.concat_tables(tables, promote_options="default")  # what older shards lack is null
    faces = [_faces_of_rows(shard, read_cloud(folder, manifest, shard.object_name)) for shard in shards]
    shard_bytes = sum(shard_path(folder, name).stat().st_size for name in names)
    cloud_bytes = sum(cloud_path(folder, name).stat().st_size for name in names)
    return DatasetInfo(
        manifest=manifest,
        num_objects=len(names),
        missing_objects=len(set(manifest.objects) - set(names) - set(manifest.failed_objects)),
        counts=counts,
        num_held=rows.num_rows - rows.column("hold_translation").null_count,
        tables={
            "counts": _counts_table(counts),
            **_coverage_tables(rows, np.concatenate([np.zeros((0, len(FACES)), dtype=bool), *faces]), manifest),
            **_histograms(rows),
            **_turns_table([shard for shard in shards if shard.turns is not None]),
            "joints": _joints_table(column_matrix(rows, "q")[:, POSE_DIMENSIONS:], manifest, folder),
        },
        bytes_on_disk=shard_bytes + cloud_bytes + (folder / MANIFEST_NAME).stat().st_size,
        bytes_per_row=shard_bytes / rows.num_rows if rows.num_rows else 0.0,
    )


def known_hand(manifest: Manifest, folder: Path) -> Hand | None:
    """Return the manifest's hand; None when it cannot be loaded here, or has other joints by now."""
    try:
        hand = manifest.load_hand(folder)
    except (HandError, UnknownNameError):  # counts can be read without the hand's files
        return None
    return hand if hand.joint_names == manifest.joint_names else None


def surface_normals(points: Float[np.ndarray, "n 3"], cloud: Float[np.ndarray, "point 6"]) -> Float[np.ndarray, "n 3"]:
    """Return the object's outward unit normal at points of its surface [m], from stored surface points with normals.

    Each takes the normal of the neighbour c whose tangent plane it lies on: the least |n_c (p - c)| + 0.1 |p - c|.
    """
    neighbours = min(NEIGHBOURS, len(cloud))
    distance, index = cKDTree(cloud[:, :3]).query(points, k=[*range(1, neighbours + 1)])
    normals = cloud[index, 3:]
    off_plane = np.abs(np.einsum("nki,nki->nk", normals, points[:, None] - cloud[index, :3]))
    best = np.argmin(off_plane + NEARNESS * distance, axis=1)
    return normals[np.arange(len(points)), best]


def contact_faces(points: Float[np.ndarray, "n 3"], cloud: Float[np.ndarray, "point 6"]) -> Int[np.ndarray, " n"]:
    """Return the index into `FACES` of the direction that is closest to the normal at each contact point [m]."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    return np.argmax(surface_normals(points, cloud) @ NORMALS.T, axis=1)


def palm_octants(translation: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Return the index into `OCTANTS` of the azimuth at which the palm's origin stands around the object's centre."""
    azimuth = np.arctan2(translation[:, 1], translation[:, 0])
    return np.rint(azimuth / (np.pi / 4)).astype(np.int64) % len(OCTANTS)


def round_edges(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " edge"]:
    """Return edges at multiples of a round width that enclose all values in at most about `BINS` bins."""
    low, high = float(values.min()), float(values.max())
    wanted = max((high - low) / BINS, 1e-12 * max(abs(low), abs(high), 1.0))
    power = 10.0 ** np.floor(np.log10(wanted))
    width = power * min(factor for factor in ROUND if factor * power >= wanted * (1 - 1e-9))
    first, last = np.floor(low / width), np.ceil(high / width)
    # Products like 3 * 0.1 may fall a hair inside the outermost value.
    edges = np.arange(first, max(last, first + 1) + 1) * width
    edges[0], edges[-1] = min(edges[0], low), max(edges[-1], high)
    return edges


def histogram(quantity: str, groups: dict[str, Float[np.ndarray, " n"]]) -> tuple[Table, Table]:
    """Return rows by bin, each bin headed by its lower edge, and the quantiles; groups without values are left out.

    A bin holds what is at least its edge and below the next; the last one holds its upper edge, too.
    """
    groups = {label: values for label, values in groups.items() if len(values)}
    edges = round_edges(np.concatenate(list(groups.values())))
    bins: list[tuple[Cell, ...]] = [
        (label, *np.histogram(values, edges)[0].tolist()) for label, values in groups.items()
    ]
    quantiles: list[tuple[Cell, ...]] = [
        (label, *(float(f"{value:.3g}") for value in np.quantile(values, list(QUANTILES.values()))))
        for label, values in groups.items()
    ]
    return (
        Table(f"{quantity} from", ("rows", *(f"{edge:.4g}" for edge in edges[:-1])), tuple(bins), chart="bars"),
        Table(quantity, ("behaviour", *QUANTILES), tuple(quantiles)),
    )


def _counts_table(counts: dict[str, BehaviourCounts]) -> Table:
    """What became of every attempt."""
    reasons = sorted({reason for count in counts.values() for reason in count.rejected})
    rows: list[tuple[Cell, ...]] = []
    for behaviour, count in counts.items():
        share: Cell = round(100.0 * count.kept / count.attempted, 1) if count.attempted else "-"
        rejected = [count.rejected.get(reason, 0) for reason in reasons]
        rows.append((behaviour, count.attempted, count.kept, share, count.failed, *rejected))
    header = ("behaviour", "attempted", "kept", "kept %", "failed", *(f"rejected: {reason}" for reason in reasons))
    return Table("behaviour", header, tuple(rows))


def _coverage_tables(rows: pa.Table, faces: Bool[np.ndarray, "row face"], manifest: Manifest) -> dict[str, Table]:
    """Digits, directions, contact faces and the palm's place: rows, and objects where it matters."""
    behaviour, objects = _strings(rows, "behaviour"), _strings(rows, "object")
    movable = behaviour != "grasp"
    place = {digit: index for index, digit in enumerate(manifest.joint_groups)}
    digits = np.zeros((rows.num_rows, len(place)), dtype=bool)
    for row, used in enumerate(rows.column("digits").to_pylist()):
        digits[row, [place[digit] for digit in used]] = True
    numbers = digits.sum(axis=1)[:, None] == np.arange(len(place) + 1)
    octants = palm_octants(column_matrix(rows, "q")[:, :3])[:, None] == np.arange(len(OCTANTS))
    feasible = column_matrix(rows, "direction_margin") >= FEASIBLE_MARGIN
    angles = tuple(f"{angle:g}" for angle in np.degrees(direction_angles()).round(6))

    def by_behaviour(title: str, kinds: Sequence[str], member: Bool[np.ndarray, "row kind"]) -> Table:
        counted: tuple[tuple[Cell, ...], ...] = tuple(
            (name, *member[behaviour == name].sum(axis=0).tolist()) for name in BEHAVIOURS
        )
        return Table(title, ("behaviour", *kinds), counted, chart="bars")

    def objects_with(member: Bool[np.ndarray, "row kind"]) -> list[int]:
        return [len(np.unique(objects[movable & column])) for column in member.T]

    return {
        "digit_numbers": by_behaviour("rows by digits in contact", [str(k) for k in range(len(place) + 1)], numbers),
        "digits": by_behaviour("rows that use the digit", tuple(place), digits),
        "directions": Table(
            "feasible direction [deg]",
            ("non-prehensile", *angles),
            (("rows", *feasible[movable].sum(axis=0).tolist()), ("objects", *objects_with(feasible))),
            chart="bars",
        ),
        "faces": by_behaviour("rows that touch the face", FACES, faces),
        "face_objects": Table(
            "objects with a push, press or hook on the face", ("objects", *FACES), (("objects", *objects_with(faces)),)
        ),
        "octants": by_behaviour("rows by where the palm stands", OCTANTS, octants),
    }


def _turns_table(shards: Sequence[Shard]) -> dict[str, Table]:
    """Rows that can turn or tip their object, of those judged; nothing for a dataset from before turns were judged."""
    if not shards:
        return {}
    able = np.concatenate([column_matrix(shard.table, "turn_margin") >= FEASIBLE_MARGIN for shard in shards])
    behaviour = np.concatenate([_strings(shard.table, "behaviour") for shard in shards])
    counted: tuple[tuple[Cell, ...], ...] = tuple(
        (name, int((behaviour == name).sum()), *able[behaviour == name].sum(axis=0).tolist())
        for name in BEHAVIOURS
        if name != "grasp"
    )
    return {"turns": Table("rows that can turn the object", ("behaviour", "judged", *TURNS), counted)}


def _histograms(rows: pa.Table) -> dict[str, Table]:
    """Margin of the best direction, penetration, palm's height, and what a grasp drifted while held."""
    behaviour = _strings(rows, "behaviour")
    held = np.isfinite(_numbers(rows, "hold_translation"))
    every = np.ones(rows.num_rows, dtype=bool)
    margin = column_matrix(rows, "direction_margin").max(axis=1, initial=-np.inf)
    deepest = np.max([_numbers(rows, name) for name in PENETRATIONS], axis=0, initial=0.0)
    quantities = {
        "margin": ("force margin in the best direction", margin, behaviour != "grasp"),
        "penetration": ("deepest penetration [mm]", 1e3 * deepest, every),
        "height": ("palm's origin above the object's middle [mm]", 1e3 * column_matrix(rows, "q")[:, 2], every),
        "drift": ("drift while held [mm]", 1e3 * _numbers(rows, "hold_translation"), held),
        "turn": ("turn while held [deg]", np.degrees(_numbers(rows, "hold_rotation")), held),
    }
    tables = {}
    for name, (quantity, values, chosen) in quantities.items():
        if chosen.any():
            groups = {label: values[chosen & (behaviour == label)] for label in BEHAVIOURS}
            tables[f"{name}_bins"], tables[name] = histogram(quantity, groups)
    return tables


def _joints_table(angles: Float[np.ndarray, "row joint"], manifest: Manifest, folder: Path) -> Table:
    """Which part of its range each joint uses: in degrees or millimetres, and in percent where the limits are known."""
    spread = np.quantile(angles, [0.0, 0.5, 1.0], axis=0).T if len(angles) else np.full((angles.shape[1], 3), np.nan)
    sliding = manifest.sliding
    unit = "deg, mm of slides" if sliding.any() else "deg"
    header = ["joint", f"least [{unit}]", f"median [{unit}]", f"greatest [{unit}]"]
    cells = [np.where(sliding[:, None], 1e3 * spread, np.degrees(spread)).round(1)]
    hand = known_hand(manifest, folder)
    if hand is not None and len(angles):
        lower, upper = hand.lower[:, None], hand.upper[:, None]
        header += ["least [% of range]", "median [% of range]", "greatest [% of range]"]
        cells.append((100.0 * (spread - lower) / (upper - lower)).round() + 0.0)  # no "-0"
    rows = tuple((name, *row) for name, row in zip(manifest.joint_names, np.hstack(cells).tolist(), strict=True))
    return Table("joint", tuple(header), rows, chart="ranges" if len(cells) > 1 else "")


def _faces_of_rows(shard: Shard, cloud: Float[np.ndarray, "point 6"]) -> Bool[np.ndarray, "row face"]:
    """Which faces each row of one object touches."""
    lists = shard.table.column("contact_points").combine_chunks()
    points = lists.flatten().flatten().to_numpy(zero_copy_only=False).reshape(-1, 3).astype(np.float64)
    row = np.repeat(np.arange(len(lists)), np.diff(lists.offsets.to_numpy()))
    touched = np.zeros((len(lists), len(FACES)), dtype=bool)
    touched[row, contact_faces(points, cloud)] = True
    return touched


def _strings(rows: pa.Table, name: str) -> np.ndarray:
    return np.array(rows.column(name).to_pylist(), dtype=str)


def _numbers(rows: pa.Table, name: str) -> Float[np.ndarray, " row"]:
    """A column of numbers; NaN where it is null."""
    return rows.column(name).to_numpy().astype(np.float64)
