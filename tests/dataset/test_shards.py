"""Shards keep every value, refuse contradictions, and a damaged or foreign file is named."""

import dataclasses
import errno
import json
import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.schema import MARGIN_STEP, NORMAL_STEP, POINT_STEP, BehaviourCounts, round_configuration
from dexnudge.dataset.shards import (
    DamagedShardError,
    cloud_path,
    column_matrix,
    is_complete,
    read_cloud,
    read_shard,
    read_whole,
    shard_path,
    write_shard,
)
from dexnudge.errors import DatasetError

NAME = "object-0"


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_round_trip_keeps_every_value(toy, tmp_path, rng):
    manifest = toy.toy_manifest()
    rows = [toy.toy_row(rng, behaviour) for behaviour in ("grasp", "push", "press", "hook", "push")]
    counts = {
        "grasp": BehaviourCounts(attempted=4, kept=1, failed=1, rejected={"penetration": 2}),
        "push": BehaviourCounts(attempted=2, kept=2),
        "press": BehaviourCounts(attempted=1, kept=1),
        "hook": BehaviourCounts(attempted=1, kept=1),
    }
    cloud = toy.toy_cloud(rng)
    write_shard(tmp_path, manifest, NAME, rows, cloud, counts)
    shard = read_shard(tmp_path, manifest, NAME)
    np.testing.assert_array_equal(column_matrix(shard.table, "q"), np.float32([row.q for row in rows]))
    margins = np.array([row.direction_margin for row in rows])
    lost = margins - column_matrix(shard.table, "direction_margin")
    assert (lost >= 0.0).all()  # never more than the true margin
    assert lost.max() < MARGIN_STEP
    for column in ("behaviour", "contact_links", "digits", "seed"):
        expected = [getattr(row, column) for row in rows]
        found = [tuple(value) if isinstance(value, list) else value for value in shard.table.column(column).to_pylist()]
        assert found == expected
    for column in ("penetration_object", "penetration_environment", "penetration_self"):
        found = shard.table.column(column).to_numpy()
        np.testing.assert_array_equal(found, np.float32([getattr(row, column) for row in rows]))
    for column in ("hold_translation", "hold_rotation"):
        found = shard.table.column(column).to_pylist()
        assert found == [None if (value := getattr(row, column)) is None else np.float32(value) for row in rows]
    for row, points in zip(rows, shard.table.column("contact_points").to_pylist(), strict=True):
        np.testing.assert_allclose(points, row.contact_points, rtol=0, atol=POINT_STEP / 2)
    assert shard.counts == counts
    assert shard.mesh_hash == manifest.objects[NAME]
    stored = read_cloud(tmp_path, manifest, NAME)
    np.testing.assert_allclose(stored[:, :3], cloud[:, :3], rtol=0, atol=POINT_STEP / 2)
    np.testing.assert_allclose(stored[:, 3:], cloud[:, 3:], rtol=0, atol=NORMAL_STEP / 2)


def test_parquet_opens_without_dexnudge(toy_folder):
    table = pq.read_table(shard_path(toy_folder, NAME))
    header = json.loads(table.schema.metadata[b"dexnudge"])
    assert header["format_version"] == 2
    assert header["hand"] == "toy"
    assert header["units"] == {"length": "m", "angle": "rad"}
    assert {"config", "seed", "versions", "mesh_sha256", "counts"} <= set(header)
    assert set(table.column("object").to_pylist()) == {NAME}
    metadata = {field.name: field.metadata for field in table.schema}
    assert all(set(column) == {b"description", b"unit", b"frame"} for column in metadata.values())
    assert metadata["penetration_object"][b"unit"] == b"m"
    assert metadata["hold_rotation"][b"unit"] == b"rad"
    assert metadata["q"][b"frame"] == metadata["contact_points"][b"frame"] != b""


def test_what_is_rounded_is_stored_exactly_and_in_less_room(toy, tmp_path, rng):
    rows = [toy.toy_row(rng, "push") for _ in range(200)]
    rounded = [dataclasses.replace(row, q=round_configuration(row.q)) for row in rows]
    counts = {"push": BehaviourCounts(attempted=200, kept=200)}
    cloud = toy.toy_cloud(rng)
    path = write_shard(tmp_path, toy.toy_manifest(), NAME, rows, cloud, counts)
    plain = path.stat().st_size
    assert write_shard(tmp_path, toy.toy_manifest(), NAME, rounded, cloud, counts).stat().st_size < 0.85 * plain
    stored = column_matrix(read_shard(tmp_path, toy.toy_manifest(), NAME).table, "q")
    np.testing.assert_array_equal(stored.astype(np.float64), [row.q for row in rounded])


def test_equal_arguments_give_equal_bytes(toy, tmp_path, rng):
    row, cloud = toy.toy_row(rng, "push"), toy.toy_cloud(rng)
    written = []
    for order in (("push", "hook"), ("hook", "push")):
        counts = {"push": BehaviourCounts(attempted=4, kept=1, rejected={"b": 1, "a": 2}), "hook": BehaviourCounts()}
        counts["push"].rejected = {
            reason: counts["push"].rejected[reason] for reason in ("ab", "ba")[order[0] == "push"]
        }
        path = write_shard(
            tmp_path, toy.toy_manifest(), NAME, [row], cloud, {behaviour: counts[behaviour] for behaviour in order}
        )
        written.append(path.read_bytes() + cloud_path(tmp_path, NAME).read_bytes())
    assert written[0] == written[1]


def test_no_float_column_holds_a_dictionary(toy_folder):
    columns = pq.read_metadata(shard_path(toy_folder, NAME)).row_group(0)
    for place in range(columns.num_columns):
        column = columns.column(place)
        split = "BYTE_STREAM_SPLIT" in column.encodings
        assert split == (column.physical_type == "FLOAT"), column.path_in_schema
        assert column.compression == "ZSTD"


def test_an_object_without_rows_is_complete(toy, tmp_path, rng):
    manifest = toy.toy_manifest()
    counts = {"push": BehaviourCounts(attempted=8, failed=8)}
    assert not is_complete(tmp_path, NAME)
    write_shard(tmp_path, manifest, NAME, [], toy.toy_cloud(rng), counts)
    assert is_complete(tmp_path, NAME)
    assert column_matrix(read_shard(tmp_path, manifest, NAME).table, "q").shape == (0, toy.DIMENSION)


def test_a_shard_is_written_after_its_cloud(toy, tmp_path, rng, monkeypatch):
    def refuse(table, *_args, **_options):
        if "q" in table.schema.names:
            raise OSError("disk full")
        return write(table, *_args, **_options)

    write = pq.write_table
    monkeypatch.setattr(pq, "write_table", refuse)
    with pytest.raises(OSError, match="disk full"):
        write_shard(tmp_path, toy.toy_manifest(), NAME, [], toy.toy_cloud(rng), {})
    assert not is_complete(tmp_path, NAME)
    assert [path.name for path in tmp_path.iterdir()] == [cloud_path(tmp_path, NAME).name]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.6, 0.99])
@pytest.mark.parametrize("path_of", [shard_path, cloud_path])
def test_truncated(toy, toy_folder, share, path_of):
    path = path_of(toy_folder, NAME)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    read = read_shard if path_of is shard_path else read_cloud
    with pytest.raises(DatasetError, match="cannot be read as Parquet: truncated or not a shard"):
        read(toy_folder, toy.toy_manifest(), NAME)


def test_a_flipped_byte_is_noticed(toy, toy_folder):
    path = cloud_path(toy_folder, NAME)
    data = bytearray(path.read_bytes())
    data[200] ^= 0xFF  # inside the first column's page
    path.write_bytes(data)
    with pytest.raises(DatasetError, match="cannot be read as Parquet"):
        read_cloud(toy_folder, toy.toy_manifest(), NAME)


@pytest.mark.parametrize("path_of", [shard_path, cloud_path])
def test_a_folder_in_its_place_is_named_and_not_made_again(toy, toy_folder, path_of):
    path = path_of(toy_folder, NAME)
    path.unlink()
    path.mkdir()
    with pytest.raises(DatasetError, match=rf"{path.name} is a folder or a device; expected a file; move it away"):
        list(read_whole(toy_folder, toy.toy_manifest(), [NAME]))


@pytest.mark.parametrize(
    "error",
    [*(OSError(number, os.strerror(number)) for number in (errno.EIO, errno.EACCES, errno.EMFILE)), MemoryError()],
    ids=["EIO", "EACCES", "EMFILE", "MemoryError"],
)
@pytest.mark.parametrize("step", ["read_schema", "ParquetFile"])
def test_what_the_system_does_not_let_be_read_is_not_made_again(toy, toy_folder, monkeypatch, step, error):
    """What `read_whole` yields is damage, which `dataset generate` deletes."""

    def refuse(*_arguments, **_options):
        raise error

    monkeypatch.setattr(pq, step, refuse)
    with pytest.raises(DatasetError, match=r"cannot be read now \(.+\) and may be whole; mend that, then try again"):
        list(read_whole(toy_folder, toy.toy_manifest(), [NAME]))
    monkeypatch.undo()
    shard_path(toy_folder, NAME).write_bytes(b"PAR1")
    ((_, damage),) = read_whole(toy_folder, toy.toy_manifest(), [NAME])
    assert isinstance(damage, DamagedShardError)


def test_missing(toy, tmp_path):
    with pytest.raises(DatasetError, match="does not exist; resume"):
        read_shard(tmp_path, toy.toy_manifest(), NAME)


def test_other_hand(toy, toy_folder):
    manifest = dataclasses.replace(toy.toy_manifest(), hand="allegro")
    with pytest.raises(DatasetError, match="has hand 'toy', expected 'allegro'"):
        read_shard(toy_folder, manifest, NAME)
    for other in ({"seed": 8}, {"config": {"grasps": 3}}, {"versions": {"torch": "0.1"}}):
        with pytest.raises(DatasetError, match=rf"has {next(iter(other))} .*expected .*another dataset: delete it"):
            read_shard(toy_folder, dataclasses.replace(toy.toy_manifest(), **other), NAME)
    manifest = dataclasses.replace(toy.toy_manifest(), joint_names=toy.JOINT_NAMES[::-1])
    with pytest.raises(DatasetError, match="has joint_names"):
        read_shard(toy_folder, manifest, NAME)


def test_other_version(toy, toy_folder):
    path = shard_path(toy_folder, NAME)
    table = pq.read_table(path)
    header = json.loads(table.schema.metadata[b"dexnudge"]) | {"format_version": 0}
    del header["sha256"]  # older versions wrote none
    pq.write_table(table.replace_schema_metadata({b"dexnudge": json.dumps(header).encode()}), path)
    with pytest.raises(DatasetError, match="has format_version 0, expected 2"):
        read_shard(toy_folder, toy.toy_manifest(), NAME)


def test_foreign_parquet(toy, toy_folder):
    path = shard_path(toy_folder, NAME)
    header = pq.read_table(path).schema.metadata
    pq.write_table(pa.table({"a": [1]}), path)
    with pytest.raises(DatasetError, match="was not written by dexnudge"):
        read_shard(toy_folder, toy.toy_manifest(), NAME)
    pq.write_table(pa.table({"a": [1]}).replace_schema_metadata(header), path)
    with pytest.raises(DatasetError, match=r"has columns \['a'\], expected \['object', 'behaviour', 'q'"):
        read_shard(toy_folder, toy.toy_manifest(), NAME)


@pytest.mark.parametrize(
    ("change", "counts", "message"),
    [
        ({}, {"push": BehaviourCounts(attempted=2, kept=1)}, r"do not add up: .* got 2 != 1 \+ 0 \+ 0"),
        ({}, {}, "has 1 rows of behaviour 'push' but its counts say 0"),
        ({}, {"push": BehaviourCounts(attempted=2, kept=2)}, "has 1 rows of behaviour 'push' but its counts say 2"),
        ({"contact_points": np.zeros((9, 3))}, None, r"has contact_points \(9, 3\), expected \([12], 3\)"),
        (
            {"behaviour": "throw"},
            None,
            r"object 'object-0', row 0: behaviour holds 'throw'; expected one of grasp",
        ),
        ({"q": np.zeros(7)}, None, r"has q \(7,\) and direction_margin \(16,\), expected \(25,\) and \(16,\)"),
        ({"q": np.full(25, np.nan)}, None, r"object 'object-0', row 0: q holds nan; expected a finite number"),
    ],
)
def test_contradictions_are_not_written(toy, tmp_path, rng, change, counts, message):
    row = dataclasses.replace(toy.toy_row(rng, "push"), **change)
    if counts is None:
        counts = {row.behaviour: BehaviourCounts(attempted=1, kept=1)}
    with pytest.raises(DatasetError, match=message):
        write_shard(tmp_path, toy.toy_manifest(), NAME, [row], toy.toy_cloud(rng), counts)
    assert list(tmp_path.iterdir()) == []


POISON = {  # column -> a value that no row can have, and what is said of it
    "q": (lambda old: [*old[:-1], float("nan")], "q holds nan; expected a finite number"),
    "direction_margin": (lambda old: [float("inf"), *old[1:]], "direction_margin holds inf; expected a finite number"),
    "contact_points": (
        lambda old: [[0.0, float("nan"), 0.0]] * len(old),
        "contact_points holds nan; expected a finite",
    ),
    "penetration_self": (lambda _: float("nan"), "penetration_self holds nan; expected a finite number"),
    "hold_rotation": (lambda _: float("nan"), "hold_rotation holds nan; expected a finite number"),
    "behaviour": (lambda _: "throw", "behaviour holds 'throw'; expected one of grasp, push, press, hook"),
    "digits": (lambda _: ["FF", "XX"], "digits holds 'XX'; expected one of FF, MF, RF, TH"),
    "contact_links": (
        lambda old: [*old[:-1], "nose"],
        "contact_links holds 'nose'; expected one of ffdistal, thdistal",
    ),
}


@pytest.mark.parametrize("column", POISON)
def test_a_row_with_impossible_values_is_refused(toy, toy_folder, column):
    change, message = POISON[column]
    path = shard_path(toy_folder, NAME)
    table = pq.read_table(path)
    values, field = table.column(column).to_pylist(), table.schema.field(column)
    values[5] = change(values[5])
    changed = table.set_column(table.schema.names.index(column), field, pa.array(values, type=field.type))
    pq.write_table(changed, path)
    with pytest.raises(DatasetError, match=rf"shard-object-0.parquet, row 5: {message}"):
        read_shard(toy_folder, toy.toy_manifest(), NAME, links=("ffdistal", "thdistal"))
    if column != "contact_links":  # a hand is needed to know its links
        with pytest.raises(DatasetError, match=message):
            load_dataset(toy_folder)


def test_a_bad_cloud_is_not_written(toy, tmp_path, rng):
    with pytest.raises(DatasetError, match=r"has shape \(5, 6\), expected finite values of shape \(1024, 6\)"):
        write_shard(tmp_path, toy.toy_manifest(), NAME, [], np.zeros((5, 6)), {})
