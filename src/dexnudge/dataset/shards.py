"""Reading and writing the two Parquet files of one object: its configurations and its surface points."""

import json
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float, Float32

from dexnudge.dataset.manifest import MANIFEST_NAME, UNITS, Manifest, check_object_name
from dexnudge.dataset.parquet_footer import announced_sizes
from dexnudge.dataset.schema import (
    BEHAVIOURS,
    CLOUD_COLUMNS,
    CLOUD_POINTS,
    FORMAT_VERSION,
    LATER_COLUMNS,
    NUM_DIRECTIONS,
    POINT_STEP,
    POSE_DIMENSIONS,
    TURNS,
    BehaviourCounts,
    ConfigurationRow,
    cloud_schema,
    configuration_schema,
    floor_margin,
    round_cloud,
    round_to,
)
from dexnudge.errors import DatasetError, quote
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.jobs.digests import KEY as DIGEST
from dexnudge.jobs.digests import is_as_signed, signed
from dexnudge.jobs.json_files import from_fields, unique_keys

_METADATA_KEY = b"dexnudge"
_COLUMNS = ({*CLOUD_COLUMNS}, {*configuration_schema(0).names} - {*LATER_COLUMNS})  # of every file of ours
_PROVENANCE = ("hand", "joint_names", "config", "seed", "versions")  # of the manifest; a shard must agree on each


Turns = Float[np.ndarray, "turn 6"]
AGAIN = "generate the object again"
LARGEST_FILE = 2**28  # bytes, unpacked: some 100,000 rows of one object
SKEW = 0.01  # of the rotation's columns, which are rounded
WIDEST = 8  # bytes of a number of a shard, once read: repeated ones take none in the file


@dataclass(frozen=True, kw_only=True)
class ShardHeader:
    """What stands in a file beside what it shares with the manifest."""

    object: str
    mesh_sha256: str
    counts: dict[str, BehaviourCounts]
    turns: tuple[tuple[float, ...] | None, ...] | None = None


class DamagedShardError(DatasetError):
    """A file of the dataset that is missing, ends too early or has changed: generating its object again mends it."""


@dataclass(frozen=True, kw_only=True)
class Shard:
    """All rows of one object; `table` has the columns of `configuration_schema`, mesh_hash is of its object's mesh.

    turns: twist of each of `TURNS`, linear [m/m] at the origin and angular [rad/m], resting frame; NaN where the object
    has no such edge; None, and no column `turn_margin`, in a dataset from before turns were judged.
    """

    object_name: str
    table: pa.Table
    counts: dict[str, BehaviourCounts]
    mesh_hash: str
    turns: Turns | None = None


def column_matrix(table: pa.Table, name: str) -> Float32[np.ndarray, "row column"]:
    """Return a column of lists of one size (`q`, `direction_margin`) as a matrix."""
    column = table.column(name).combine_chunks()
    width = column.type.list_size
    return column.flatten().to_numpy(zero_copy_only=False).reshape(-1, width)


def shard_path(folder: Path | str, object_name: str) -> Path:
    """Return where the configurations of an object lie."""
    return Path(folder) / f"shard-{check_object_name(object_name)}.parquet"


def cloud_path(folder: Path | str, object_name: str) -> Path:
    """Return where the surface points of an object lie."""
    return Path(folder) / f"object-{check_object_name(object_name)}.parquet"


def complete_objects(folder: Path | str, manifest: Manifest) -> list[str]:
    """Return the names of the objects whose data has been written."""
    return [name for name in sorted(manifest.objects) if is_complete(folder, name)]


def is_complete(folder: Path | str, object_name: str) -> bool:
    """Return whether the object's data has been written; the shard is written last, so its presence is enough."""
    return shard_path(folder, object_name).exists()


def write_shard(
    folder: Path | str,
    manifest: Manifest,
    object_name: str,
    rows: Sequence[ConfigurationRow],
    cloud: Float[np.ndarray, "point 6"],
    counts: dict[str, BehaviourCounts],
    turns: Turns | None = None,
) -> Path:
    """Write one object's surface points, then its configurations, each atomically; return the shard's path.

    cloud: (1024, 6) points [m] and outward normals, resting frame. counts: per behaviour, `kept` equal to its rows.
    turns: as in `Shard`, with rows that hold a `turn_margin`.
    Margins are rounded down, points and normals to the steps of `rounding`; q is stored in single precision, without
    loss once it has gone through `round_configuration`. Equal arguments give equal bytes.
    Raises DatasetError for rows, counts or clouds that contradict each other or the manifest's hand.
    """
    _check_rows(object_name, rows, counts, len(manifest.joint_names))
    if cloud.shape != (CLOUD_POINTS, 6) or not np.isfinite(cloud).all():
        raise DatasetError(
            f"cloud of object {object_name!r} has shape {cloud.shape}, expected finite values of shape "
            f"({CLOUD_POINTS}, 6); sample {CLOUD_POINTS} surface points with normals."
        )
    table = _table(object_name, rows, len(manifest.joint_names))
    if turns is None:
        table = table.drop_columns(list(LATER_COLUMNS))
    check_rows(table, manifest, f"object {object_name!r}")
    header = _header(manifest, object_name, counts)
    cloud = round_cloud(cloud)
    points = pa.table([pa.array(cloud[:, k].astype(np.float32)) for k in range(6)], schema=cloud_schema())
    _write_table(cloud_path(folder, object_name), points, header)
    path = shard_path(folder, object_name)
    _write_table(path, table, header | _turns_entry(turns))
    return path


def write_turns(
    folder: Path | str, manifest: Manifest, shard: Shard, margin: Float[np.ndarray, "row turn"], turns: Turns | None
) -> None:
    """Write a shard again with the force margins of its rows in `TURNS`, and their twists; nothing else changes.

    turns: None takes both away.
    """
    schema = configuration_schema(len(manifest.joint_names))
    flat = pa.array(floor_margin(margin.astype(np.float64)).astype(np.float32).reshape(-1))
    columns = {name: shard.table.column(name) for name in shard.table.schema.names}
    columns["turn_margin"] = pa.FixedSizeListArray.from_arrays(flat, len(TURNS))
    table = pa.table({name: columns[name] for name in schema.names}).cast(schema)
    of_mesh = replace(manifest, objects={shard.object_name: shard.mesh_hash})
    header = _header(of_mesh, shard.object_name, shard.counts) | _turns_entry(turns)
    table = table.drop_columns(list(LATER_COLUMNS)) if turns is None else table
    _write_table(shard_path(folder, shard.object_name), table, header)


def _turns_entry(turns: Turns | None) -> dict[str, object]:
    """The twists as they stand in a header; none where they were not judged."""
    if turns is None:
        return {}
    return {"turns": [None if np.isnan(twist).any() else twist.tolist() for twist in turns]}


def read_shard(
    folder: Path | str, manifest: Manifest, object_name: str, *, links: Collection[str] | None = None
) -> Shard:
    """Read one object's configurations. links: those that the hand has; None leaves the names of contact links unchecked.

    Raises:
        DatasetError: a truncated, foreign or outdated file, or a row with numbers or names that none can have.
    """
    path = shard_path(folder, object_name)
    table, header = _read_table(path, manifest, object_name, configuration_schema(len(manifest.joint_names)))
    check_rows(table, manifest, str(path), links=links)
    own = {key: value for key, value in header.items() if key not in _shared(manifest)}
    found = from_fields(own, ShardHeader, f"{path}: its header", error=DamagedShardError, again=AGAIN)
    rotation = column_matrix(table, "q")[:, 3:POSE_DIMENSIONS].reshape(-1, 2, 3)
    sizes = [pc.list_value_length(table.column(name)).to_numpy() for name in ("contact_links", "contact_points")]
    for what, wrong in (
        ("of another object", ~np.array(pc.equal(table.column("object"), object_name), dtype=bool)),
        ("with other numbers of contact_links and contact_points", sizes[0] != sizes[1]),
        (
            "whose q holds no rotation",
            np.abs(rotation @ rotation.swapaxes(1, 2) - np.eye(2)).max((1, 2), initial=0) > SKEW,
        ),
    ):
        if wrong.any():
            raise DamagedShardError(f"{path}, row {np.argmax(wrong)} is a row {what}; {AGAIN}")
    kept = Counter(table.column("behaviour").to_pylist())
    if kept != {behaviour: count.kept for behaviour, count in found.counts.items() if count.kept}:
        raise DamagedShardError(f"{path} has other rows than its counts say were kept: {dict(kept)}; {AGAIN}")
    if wrong_counts := [name for name, count in found.counts.items() if count.accounted != count.attempted]:
        raise DamagedShardError(f"{path}: its counts of {', '.join(wrong_counts)} do not add up; {AGAIN}")
    turns = None
    if found.turns is not None and "turn_margin" in table.schema.names:
        if len(found.turns) != len(TURNS) or any(twist is not None and len(twist) != 6 for twist in found.turns):
            raise DamagedShardError(f"{path}: turns of its header are no {len(TURNS)} twists of 6 numbers; {AGAIN}")
        turns = np.array([twist or [np.nan] * 6 for twist in found.turns], dtype=np.float64)
    return Shard(object_name=object_name, table=table, counts=found.counts, mesh_hash=found.mesh_sha256, turns=turns)


def read_whole(
    folder: Path | str, manifest: Manifest, names: Sequence[str], *, links: Collection[str] | None = None
) -> Iterator[tuple[str, Shard | DamagedShardError]]:
    """Yield each object's shard after both of its files were read to the last byte, or what is wrong with them.

    Raises:
        DatasetError: a file belongs to another dataset.
    """
    for name in names:
        try:
            shard = read_shard(folder, manifest, name, links=links)
            read_cloud(folder, manifest, name)
        except DamagedShardError as error:
            yield name, error
        else:
            yield name, shard


def check_rows(table: pa.Table, manifest: Manifest, where: str, *, links: Collection[str] | None = None) -> None:
    """Refuse rows with numbers that are not finite, and with behaviours, digits or links that do not exist.

    Raises:
        DamagedShardError: names `where`, the column and the first such row.
    """
    known: dict[str, Collection[str]] = {"behaviour": BEHAVIOURS, "digits": manifest.joint_groups}
    if links is not None:
        known["contact_links"] = links
    for field in table.schema:
        values = table.column(field.name).combine_chunks()
        row = np.arange(len(values))
        while pa.types.is_nested(values.type):
            sizes = pc.list_value_length(values).to_numpy(zero_copy_only=False)
            row, values = np.repeat(row, sizes), values.flatten()
        bad = values.is_null().to_numpy(zero_copy_only=False) & (not field.nullable)
        if pa.types.is_floating(values.type):
            bad |= ~np.isfinite(values.fill_null(0.0).to_numpy(zero_copy_only=False))
        if field.name in known:
            bad |= ~np.isin(np.array(values.to_pylist(), dtype=object), list(known[field.name]))
        if bad.any():
            first = int(np.argmax(bad))
            expected = f"one of {', '.join(known[field.name])}" if field.name in known else "a finite number"
            raise DamagedShardError(
                f"{where}, row {row[first]}: {field.name} holds {quote(values[first].as_py())}; expected {expected}; "
                "generate the object again."
            )


def read_cloud(folder: Path | str, manifest: Manifest, object_name: str) -> Float32[np.ndarray, "point 6"]:
    """Read one object's surface points [m] and normals, resting frame; raises DatasetError like `read_shard`."""
    path = cloud_path(folder, object_name)
    table, _ = _read_table(path, manifest, object_name, cloud_schema())
    if table.num_rows != CLOUD_POINTS:
        raise DamagedShardError(f"{path} has {table.num_rows} points, expected {CLOUD_POINTS}; {AGAIN}")
    cloud = np.stack([table.column(name).to_numpy() for name in CLOUD_COLUMNS], axis=1)
    if not np.isfinite(cloud).all():
        raise DamagedShardError(f"{path} has points that are not finite; generate the object again.")
    return cloud


def _shared(manifest: Manifest) -> dict[str, object]:
    """What all files of a dataset say alike."""
    return {"format_version": FORMAT_VERSION, "units": UNITS, **{key: getattr(manifest, key) for key in _PROVENANCE}}


def _header(manifest: Manifest, object_name: str, counts: dict[str, BehaviourCounts]) -> dict[str, object]:
    """Where the file comes from; no clock and no order of completion in it, so that equal runs give equal bytes."""
    ordered = {
        behaviour: asdict(count) | {"rejected": dict(sorted(count.rejected.items()))}
        for behaviour, count in sorted(counts.items())
    }
    return {
        **_shared(manifest),
        "object": object_name,
        "mesh_sha256": manifest.objects.get(object_name) or "",
        "counts": ordered,
    }


def _table(object_name: str, rows: Sequence[ConfigurationRow], num_joints: int) -> pa.Table:
    schema = configuration_schema(num_joints)
    columns: dict[str, list] = {"object": [object_name] * len(rows)}
    columns |= {name: [getattr(row, name) for row in rows] for name in schema.names if name != "object"}
    columns["q"] = [np.float32(q) for q in columns["q"]]
    for name in ("direction_margin", "turn_margin"):
        columns[name] = [m if m is None else np.float32(floor_margin(np.float64(m))) for m in columns[name]]
    columns["contact_points"] = [list(round_to(p, POINT_STEP).astype(np.float32)) for p in columns["contact_points"]]
    return pa.Table.from_arrays([pa.array(columns[each.name], type=each.type) for each in schema], schema=schema)


def _check_rows(
    object_name: str, rows: Sequence[ConfigurationRow], counts: dict[str, BehaviourCounts], num_joints: int
) -> None:
    for behaviour, count in counts.items():
        count.validate(behaviour)
    for behaviour in sorted({*counts, *(row.behaviour for row in rows)}):
        found = sum(row.behaviour == behaviour for row in rows)
        claimed = counts[behaviour].kept if behaviour in counts else 0
        if found != claimed:
            raise DatasetError(
                f"object {object_name!r} has {found} rows of behaviour {behaviour!r} but its counts say {claimed} "
                "were kept; count every kept row."
            )
    for index, row in enumerate(rows):
        if row.q.shape != (POSE_DIMENSIONS + num_joints,) or row.direction_margin.shape != (NUM_DIRECTIONS,):
            raise DatasetError(
                f"row {index} of object {object_name!r} has q {row.q.shape} and direction_margin "
                f"{row.direction_margin.shape}, expected ({POSE_DIMENSIONS + num_joints},) and ({NUM_DIRECTIONS},)."
            )
        if row.contact_points.shape != (len(row.contact_links), 3):
            raise DatasetError(
                f"row {index} of object {object_name!r} has contact_points {row.contact_points.shape}, expected "
                f"({len(row.contact_links)}, 3): one point for each of its contact_links."
            )


def _write_table(path: Path, table: pa.Table, header: dict[str, object]) -> None:
    # Parquet has checksums of its pages, and none of its footer, where the header stands.
    table = table.replace_schema_metadata({_METADATA_KEY: json.dumps(signed(header)).encode()})
    leaves = dict(map(_leaf, table.schema))
    floats = [path for path, kind in leaves.items() if pa.types.is_floating(kind)]
    with replace_atomically(path) as temporary:
        pq.write_table(
            table,
            temporary,
            compression="zstd",
            use_dictionary=[path for path in leaves if path not in floats],
            # One stream for each byte of the mantissa: after rounding the last ones are zero and take no room.
            column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
            write_page_checksum=True,
        )


def _leaf(field: pa.Field) -> tuple[str, pa.DataType]:
    """Path and type by which Parquet knows the values of a column."""
    path, kind = field.name, field.type
    while pa.types.is_nested(kind):
        path, kind = f"{path}.list.element", kind.value_type
    return path, kind


def _check_size(path: Path) -> None:
    """Refuse a file before it takes memory: what it announces is what a reader makes room for."""
    sizes = announced_sizes(path)
    unpacked = sum(max(size, values * WIDEST) for values, size in sizes)
    if unpacked > LARGEST_FILE:
        raise DamagedShardError(
            f"{path} announces {sum(values for values, _ in sizes)} values, {unpacked >> 20} MiB when read; expected at "
            f"most {LARGEST_FILE >> 20} MiB; {AGAIN}"
        )


def read_header(path: Path) -> dict[str, Any]:
    """Return what a file says of itself, without its rows: `ShardHeader`, and what it shares with the manifest.

    Raises:
        DatasetError: a truncated or foreign file, or one that the system does not let be read.
    """
    if not path.exists():
        raise DamagedShardError(f"{path} does not exist; resume `dexnudge dataset generate` to write it.")
    if not path.is_file():
        raise DatasetError(f"{path} is a folder or a device; expected a file; move it away.")
    with _readable(path):
        _check_size(path)
        schema = pq.read_schema(path)
    text = (schema.metadata or {}).get(_METADATA_KEY)
    if text is None and not any(columns <= {*schema.names} for columns in _COLUMNS):
        raise DatasetError(f"{path} was not written by dexnudge: it has no header; delete it.")
    try:
        header = dict(json.loads(text or b"", object_pairs_hook=unique_keys).items())
    except (AttributeError, ValueError, RecursionError) as error:
        raise DamagedShardError(f"{path}: its header cannot be read; {AGAIN}") from error
    if not is_as_signed(header):
        raise DamagedShardError(f"{path}: its header has another checksum than it says; {AGAIN}")
    return {key: value for key, value in header.items() if key != DIGEST}


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise what cannot be read as Parquet in the block as DamagedShardError, what may be whole as DatasetError."""
    try:
        yield
    except DamagedShardError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
        if isinstance(error, MemoryError) or getattr(error, "errno", None) is not None:  # the system's, not Parquet's
            why = str(error) or "out of memory"
            raise DatasetError(
                f"{path} cannot be read now ({why}) and may be whole; mend that, then try again."
            ) from error
        raise DamagedShardError(
            f"{path} cannot be read as Parquet: truncated or not a shard ({error}); "
            "resume `dexnudge dataset generate` to make it again."
        ) from error


def _read_texts_once(path: Path, metadata: pq.FileMetaData, schema: pa.Schema) -> pa.Table:
    """Return the rows; a text that many of them hold is read as one, and copied for each once that has a bound."""
    texts = [name for name, kind in map(_leaf, schema) if pa.types.is_string(kind)]
    with pq.ParquetFile(path, metadata=metadata, read_dictionary=texts, page_checksum_verification=True) as file:
        parts = [file.read_row_group(k) for k in range(file.num_row_groups)]  # one dictionary each
    size = sum(_text_bytes(chunk) for part in parts for column in part.columns for chunk in column.chunks)
    if size > LARGEST_FILE:
        raise DamagedShardError(
            f"{path} has {size >> 20} MiB of texts when read; expected at most {LARGEST_FILE >> 20} MiB; {AGAIN}"
        )
    return pa.concat_tables([part.cast(schema) for part in parts] or [schema.empty_table()])


def _text_bytes(values: pa.Array) -> int:
    """How many bytes the texts of a column take that is read as a dictionary; 0 of others."""
    while pa.types.is_nested(values.type):
        values = values.flatten()
    if not pa.types.is_dictionary(values.type):
        return 0
    sizes = pc.binary_length(values.dictionary).to_numpy(zero_copy_only=False)
    return int(sizes[values.indices.drop_null().to_numpy(zero_copy_only=False)].sum(dtype=np.int64))


def _read_table(path: Path, manifest: Manifest, object_name: str, schema: pa.Schema) -> tuple[pa.Table, dict]:
    header = read_header(path)
    for key, value in json.loads(json.dumps({**_shared(manifest), "object": object_name})).items():
        if key not in header:
            raise DamagedShardError(f"{path}: its header lacks {key}; {AGAIN}")
        if header[key] != value:
            raise DatasetError(
                f"{path} has {key} {header[key]!r}, expected {value!r}; "
                f"it belongs to another dataset: delete it, or {MANIFEST_NAME} where that is what has changed, and resume "
                "`dexnudge dataset generate`."
            )
    with _readable(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        found = file.schema_arrow
        expected = pa.schema([each for each in schema if each.name in found.names or each.name not in LATER_COLUMNS])
        fits = found.equals(expected, check_metadata=False)
        table = _read_texts_once(path, file.metadata, expected) if fits else None
    if found.names != expected.names:
        raise DamagedShardError(f"{path} has columns {found.names}, expected {schema.names}; {AGAIN}")
    if table is None:
        wrong = [each.name for each, right in zip(found, expected, strict=True) if not each.equals(right)]
        raise DamagedShardError(f"{path} has values of another type in {', '.join(wrong)}; {AGAIN}")
    return table, header
