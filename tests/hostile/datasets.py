"""Hostile datasets: shards, clouds and the manifest."""

from __future__ import annotations

import io
import json
import random
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dataset.footers import more_rows, one_list, with_number
from dataset.toy import toy_manifest, write_toy_dataset
from hostile.case import CONTROL, MARKUP, Content, Draw, Hostile, Link, Pipe, as_content, copied
from hostile.checkpoints import TRAIN
from hostile.mutations import changed_value, damaged_bytes, damaged_json, odd_values

SHARD, CLOUD, MANIFEST = "data/shard-object-0.parquet", "data/object-object-0.parquet", "data/manifest.json"
COMMANDS = (("dataset", "check", "data"), ("dataset", "info", "data"), tuple(TRAIN))
HEADER = b"dexnudge"


@cache
def data() -> dict[str, bytes]:
    """Return the files of a made-up dataset of a hand that exists."""
    folder = Path(tempfile.mkdtemp())
    write_toy_dataset(folder, num_objects=2, rows=6, manifest=replace(toy_manifest(2), hand="shadow_lite"))
    return {f"data/{name}": content for name, content in copied(folder).items()}


@cache
def table(name: str = SHARD) -> pa.Table:
    """Return a file of it as a table."""
    return pq.read_table(io.BytesIO(data()[name]))


def written(changed: pa.Table, **options: Any) -> bytes:
    """Return a table as Parquet."""
    file = io.BytesIO()
    pq.write_table(changed, file, **options)
    return file.getvalue()


def case(
    name: str, files: dict[str, Content], expected: Any = "either", says: str = "", *, command: int = 0
) -> Hostile:
    """Return the case of a dataset in which these files stand."""
    return Hostile("dataset", name, {**data(), **files}, COMMANDS[command], expected, says)


def _column(name: str, change: Callable[[list[Any]], list[Any]], rows: int | None = None) -> pa.Table:
    """The shard with another column; rows: all are the first, so many times."""
    whole = table() if rows is None else table().take(np.zeros(rows, dtype=np.int64))
    place = whole.schema.get_field_index(name)
    values = pa.array(change(whole.column(name).to_pylist()), whole.schema.field(name).type)
    return whole.set_column(place, whole.schema.field(name), values)


def _first(value: Any, where: int | None = None) -> Callable[[list[Any]], list[Any]]:
    """Put a value in the first row, or in the first row's list."""

    def change(rows: list[Any]) -> list[Any]:
        if where is not None:
            inside = list(rows[0])
            inside[where] = value
            return [inside, *rows[1:]]
        return [value, *rows[1:]]

    return change


def _with_header(change: Callable[[dict[str, Any]], Any]) -> bytes:
    whole = table()
    content = json.loads(whole.schema.metadata[HEADER])
    content.pop("sha256", None)  # as versions without it wrote it: what is meant ill is no accident
    content = change(content)
    text = content if isinstance(content, bytes) else as_content(content)
    return written(whole.replace_schema_metadata({HEADER: text}))


def _draw(rng: random.Random) -> Hostile:
    command, which = rng.choice((0, 0, 1, 2)), rng.random()
    if which < 0.3:
        manifest = json.loads(data()[MANIFEST])
        if rng.random() < 0.5:
            key = rng.choice([*manifest])
            return case(f"another {key}", {MANIFEST: as_content(manifest | {key: odd_values(rng)})}, command=command)
        what, content = damaged_json(manifest, rng)
        return case(f"manifest: {what}", {MANIFEST: content}, command=command)
    if which < 0.6:
        name = rng.choice((SHARD, CLOUD))
        what, content = damaged_bytes(data()[name], rng)
        return case(f"{name}: {what}", {name: content}, command=command)
    if which < 0.8:
        said: list[str] = []

        def change(header: dict[str, Any]) -> Any:
            if rng.random() < 0.2:
                what, text = damaged_json(header, rng)
            else:
                what, found = changed_value(header, rng)
                text = as_content(found)
            said.append(what)
            return text

        content = _with_header(change)
        return case(f"header: {said[0]}", {SHARD: content}, command=command)
    if which < 0.85:
        found = pq.read_metadata(io.BytesIO(data()[SHARD]))
        chunk = found.row_group(0).column(rng.randrange(found.num_columns))
        number = rng.choice(("num_values", "total_uncompressed_size", "total_compressed_size", "data_page_offset"))
        other = rng.choice((0, 1, 2**31 - 1, 2**31, 10**9, 2**62, getattr(chunk, number) + 1))
        lie = with_number(data()[SHARD], getattr(chunk, number), other)
        return case(f"{number} {other}", {SHARD: lie}, command=command)
    whole = table(SHARD)
    name = rng.choice(whole.schema.names)
    kind = rng.choice(
        (pa.int64(), pa.float64(), pa.string(), pa.binary(), pa.list_(pa.float32()), pa.null(), pa.bool_())
    )
    place = whole.schema.get_field_index(name)
    change_type = whole.set_column(place, name, pa.nulls(len(whole), kind))
    changed = rng.choice((whole.drop_columns([name]), change_type, whole.slice(0, 2), pa.concat_tables([whole, whole])))
    return case(f"column {name}", {SHARD: written(changed)}, command=command)


def handmade() -> list[Hostile]:
    """Return the cases made by hand."""
    manifest, whole = json.loads(data()[MANIFEST]), table()
    cloud = table(CLOUD)
    huge = pa.table({"x": pa.array(np.zeros(50_000_000, dtype=np.int8))})
    cases: dict[str, tuple[Any, ...]] = {
        "valid": ({}, "accepted"),
        "NaN in q": ({SHARD: written(_column("q", _first(float("nan"), 3)))}, "refused", "q"),
        "infinity in q": ({SHARD: written(_column("q", _first(float("inf"), 3)))}, "refused", "q"),
        "NaN in a margin": ({SHARD: written(_column("direction_margin", _first(float("nan"), 0)))}, "refused", "direction_margin"),
        "an unknown behaviour": ({SHARD: written(_column("behaviour", _first("dance")))}, "refused", "behaviour"),
        "an unknown link": ({SHARD: written(_column("contact_links", _first([MARKUP])))}, "refused", "contact_links"),
        "a link of control characters": ({SHARD: written(_column("contact_links", _first([CONTROL])))}, "refused", "contact_links"),
        "a link of 10 MB": ({SHARD: written(_column("contact_links", _first(["a" * 10_000_000])))}, "refused", "contact_links"),
        "more links than points": ({SHARD: written(_column("contact_links", _first(["ffdistal"] * 9)))}, "refused", ""),
        "a point of 1e30": ({SHARD: written(_column("contact_points", _first([[1e30, 0, 0]])))}, "either", ""),
        "an unknown digit": ({SHARD: written(_column("digits", _first(["ZZ"])))}, "refused", "digits"),
        "another object's rows": ({SHARD: written(_column("object", _first("object-1")))}, "refused", "object"),
        "a q that is no pose": ({SHARD: written(_column("q", _first([0.0] * 25)))}, "refused", "q"),
        "50,000,000 zeros": ({SHARD: written(huge, compression="zstd")}, "refused", ""),
        "1,000,000 rows": ({SHARD: written(whole.take(np.zeros(1_000_000, dtype=np.int64)), compression="zstd")}, "refused", ""),
        "10 kB of a name in 30,000 rows": ({SHARD: written(_column("object", lambda _: ["a" * 10_000] * 30_000, 30_000))}, "refused", "texts"),
        "10 kB of a link in 30,000 rows": ({SHARD: written(_column("contact_links", lambda _: [["a" * 10_000]] * 30_000, 30_000))}, "refused", "texts"),
        "a name that continues": ({SHARD: written(whole, use_dictionary=False, column_encoding={"object": "DELTA_BYTE_ARRAY"})}, "refused", "continue"),
        "rows that are not there": ({SHARD: more_rows(whole.schema.metadata)}, "refused", "announces"),
        "a list longer than its footer says": ({SHARD: one_list(whole.schema.metadata)}, "refused", "announces"),
        "foreign": ({SHARD: written(pa.table({"a": [1]}))}, "refused", "header"),
        "no rows": ({SHARD: written(whole.slice(0, 0))}, "refused", ""),
        "a row less": ({SHARD: written(whole.slice(1))}, "refused", ""),
        "a header under another key": ({SHARD: written(whole.replace_schema_metadata({b"dexnudgd": whole.schema.metadata[HEADER]}))}, "refused", "header"),
        "another column": ({SHARD: written(whole.rename_columns(["objecu", *whole.schema.names[1:]]).replace_schema_metadata(whole.schema.metadata))}, "refused", "columns"),
        "a header of a list": ({SHARD: _with_header(lambda _: [])}, "refused", ""),
        "a header of bytes": ({SHARD: _with_header(lambda _: b"\xff\xfe")}, "refused", ""),
        "a header nested 100,000 deep": ({SHARD: _with_header(lambda _: b"[" * 100_000)}, "refused", ""),
        "counts of text": ({SHARD: _with_header(lambda h: h | {"counts": "many"})}, "refused", "counts"),
        "counts below 0": ({SHARD: _with_header(lambda h: h | {"counts": {"push": {"attempted": -1, "kept": 3, "failed": 0, "rejected": {}}}})}, "refused", ""),
        "no counts": ({SHARD: _with_header(lambda h: {k: v for k, v in h.items() if k != "counts"})}, "refused", "counts"),
        "turns of text": ({SHARD: _with_header(lambda h: h | {"turns": ["x"] * 10})}, "refused", "turn"),
        "turns of 1e400": ({SHARD: _with_header(lambda h: h | {"turns": [[1e400] * 6] * 10})}, "refused", "turn"),
        "a hash of a list": ({SHARD: _with_header(lambda h: h | {"mesh_sha256": [1]})}, "refused", ""),
        "a cloud of NaN": ({CLOUD: written(cloud.set_column(0, cloud.schema.field(0), pa.array([float("nan")] * len(cloud), pa.float32())))}, "refused", ""),
        "a cloud of 3 points": ({CLOUD: written(cloud.slice(0, 3))}, "refused", ""),
        "no cloud": ({CLOUD: Link("nothing")}, "refused", ""),
        "a pipe": ({SHARD: Pipe()}, "refused", ""),
        "a device": ({SHARD: Link("/dev/zero")}, "refused", ""),
        "a manifest that is a pipe": ({MANIFEST: Pipe()}, "refused", ""),
        "a manifest of a list": ({MANIFEST: b"[]"}, "refused", ""),
        "a manifest of NaN": ({MANIFEST: as_content(manifest | {"seed": float("nan")})}, "refused", ""),
        "a manifest nested 100,000 deep": ({MANIFEST: b"[" * 100_000}, "refused", ""),
        "an object's name that leads outside": ({MANIFEST: as_content(manifest | {"objects": {"../../etc/passwd": None}})}, "refused", "name"),
        "objects of a list": ({MANIFEST: as_content(manifest | {"objects": ["object-0"]})}, "refused", "objects"),
        "joint names twice": ({MANIFEST: as_content(manifest | {"joint_names": ["a"] * 16})}, "refused", ""),
        "groups beyond the joints": ({MANIFEST: as_content(manifest | {"digit_joints": {"FF": [99]}})}, "refused", ""),
        "groups of text": ({MANIFEST: as_content(manifest | {"digit_joints": {"FF": ["0"]}})}, "refused", ""),
        "a hand at a device": ({MANIFEST: as_content(manifest | {"config": {"hand": "/dev/zero"}})}, "refused", ""),
        "a hand of markup": ({MANIFEST: as_content(manifest | {"hand": MARKUP})}, "refused", ""),
    }  # fmt: skip
    return [
        case(f"{name}, {COMMANDS[command][0]} {COMMANDS[command][1]}", *values, command=command)
        for name, values in cases.items()
        for command in (
            range(3) if name in ("valid", "NaN in q", "a pipe", "counts of text", "50,000,000 zeros") else (0,)
        )
    ]


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"dataset": _draw}
