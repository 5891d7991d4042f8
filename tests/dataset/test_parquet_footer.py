"""What a footer announces is read as pyarrow reads it; a damaged one is refused, and never ends the process."""

import random
import re
import struct
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dataset.footers import ONE_LIST, more_rows, one_list
from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.parquet_footer import announced_sizes
from dexnudge.dataset.shards import DamagedShardError, read_shard, shard_path

NAME = "object-0"
FLIPS = 600
READ_EACH = """
import sys
from pathlib import Path
from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.shards import DamagedShardError, read_shard, shard_path

folder = Path(sys.argv[1])
manifest, path = read_manifest(folder), shard_path(folder, "object-0")
whole, good = path.read_bytes(), read_shard(folder, manifest, "object-0")
for line in sys.stdin:
    at, bit = map(int, line.split())
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :])
    try:
        shard = read_shard(folder, manifest, "object-0")
    except DamagedShardError as error:
        print("refused" if str(path) in str(error) else f"refused without its name: {error}")
    else:
        same = shard.table.equals(good.table) and (shard.counts, shard.mesh_hash) == (good.counts, good.mesh_hash)
        print("same" if same else f"another shard after a flip at {at} {bit}")
"""

READ_LIMITED = """
import resource, sys
from pathlib import Path
from dexnudge.dataset.parquet_footer import announced_sizes

resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))
try:
    announced_sizes(Path(sys.argv[1]))
except ValueError:
    print("refused")
"""
READ_MEASURED = """
import sys
import pyarrow as pa
from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.shards import read_shard
from dexnudge.errors import DatasetError

for name in ("object-0", "object-1"):
    try:
        read_shard(sys.argv[1], read_manifest(sys.argv[1]), name)
    except DatasetError as error:
        print(error)
print(pa.default_memory_pool().max_memory())
"""


def footer_begin(content: bytes) -> int:
    return len(content) - 8 - struct.unpack("<I", content[-8:-4])[0]


@pytest.mark.parametrize("options", [{}, {"row_group_size": 7}, {"compression": "zstd", "write_statistics": False}])
def test_sizes_are_those_that_pyarrow_finds(tmp_path, options):
    rows = 40
    lists = pa.array([[0.5] * (k % 5) for k in range(rows)])
    table = pa.table({"a": range(rows), "b": lists, "c": ["x" * k for k in range(rows)], "d": [True] * rows})
    pq.write_table(table, tmp_path / "t.parquet", **options)
    found = pq.read_metadata(tmp_path / "t.parquet")
    chunks = [found.row_group(k).column(n) for k in range(found.num_row_groups) for n in range(found.num_columns)]
    expected = [(chunk.num_values, chunk.total_uncompressed_size) for chunk in chunks]
    assert announced_sizes(tmp_path / "t.parquet") == expected


@pytest.mark.parametrize(
    "footer",
    [
        b"",
        b"\xff" * 40,
        b"\x19" * 4000,
        b"\x1c" * 4000,
        b"\x19\xfc\xff\xff\xff\xff\x0f" + bytes(9),
        b"\x18\xff\x7f\x00",
        b"\x19\x0c\x38\x01",
        b"\x49\x0c\x0a\x08\x0c\x00",
        b"\x4a\x0c\x00",
        b"\x49\x05\x00",
        b"\x4c\x00\x00",
        b"\x49\x1c\x19\x1c\x3c\x55\x02\x16\x04\x16\x00\x26\x00\x00\x00\x26\x02\x00\x00",
        b"\x09\x88\x80\x08\x0c\x00",
    ],
    ids=[
        "empty",
        "number",
        "nested lists",
        "nested structures",
        "a list without end",
        "a text without end",
        "a text beyond the end",
        "row groups twice",
        "a set of row groups",
        "row groups that are numbers",
        "row groups that are a structure",
        "a number of values of 32 bits",
        "a field that is the 4th in 16 bits",
    ],
)
def test_what_is_no_footer_is_refused(tmp_path, footer):
    path = tmp_path / "t.parquet"
    path.write_bytes(b"PAR1" + footer + struct.pack("<I", len(footer)) + b"PAR1")
    with pytest.raises(ValueError, match="its footer"):
        announced_sizes(path)
    path.write_bytes(b"PAR1")
    with pytest.raises(ValueError, match="it has no footer"):
        announced_sizes(path)


def test_a_footer_by_hand_is_read(tmp_path):
    """The refused ones above differ from this one in what their names say."""
    footer = b"\x49\x1c\x19\x1c\x3c\x56\x02\x16\x04\x16\x00\x26\x00\x00\x00\x26\x02\x00\x00"
    path = tmp_path / "t.parquet"
    path.write_bytes(b"PAR1" + footer + struct.pack("<I", len(footer)) + b"PAR1")
    assert announced_sizes(path) == [(1, 2)]


@pytest.mark.parametrize("kind", range(1, 13))
@pytest.mark.parametrize("count", [300_000_000, 10**12])
def test_a_list_with_more_values_than_bytes_is_refused_at_once(tmp_path, kind, count):
    varint = bytes(count >> shift & 127 | 128 for shift in range(0, 35, 7)) + bytes([count >> 35])
    footer = bytes([0x19, 0xF0 | kind]) + varint + b"\0"
    path = tmp_path / "t.parquet"
    path.write_bytes(b"PAR1" + footer + struct.pack("<I", len(footer)) + b"PAR1")
    done = subprocess.run([sys.executable, "-c", READ_LIMITED, str(path)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "refused\n"), done.stderr[-500:]


def test_repeated_values_of_many_row_groups_are_refused_before_they_take_memory(toy_folder):
    """Each group has 8 MiB and takes a few kB of the file."""
    column = pa.table({"x": np.zeros(2**20, dtype=np.int64)})
    for name, groups in ((NAME, 40), ("object-1", 30)):
        path = shard_path(toy_folder, name)
        zeros = column.replace_schema_metadata(pq.read_schema(path).metadata)
        with pq.ParquetWriter(path, zeros.schema, compression="zstd") as writer:
            for _ in range(groups):
                writer.write_table(zeros)
        assert path.stat().st_size < 10**6
    command = [sys.executable, "-c", READ_MEASURED, str(toy_folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-500:]
    too_large, foreign, peak = done.stdout.splitlines()
    assert "announces 41943040 values, 320 MiB when read; expected at most 256 MiB" in too_large
    assert "has columns ['x'], expected" in foreign
    assert int(peak) < 2**20


@pytest.mark.parametrize(("file", "values"), [(more_rows, 10**9), (one_list, ONE_LIST)])
def test_a_footer_that_says_less_than_its_pages_is_refused_before_it_takes_memory(toy_folder, file, values):
    for name in (NAME, "object-1"):
        path = shard_path(toy_folder, name)
        path.write_bytes(file(pq.read_schema(path).metadata))
        assert path.stat().st_size < 10**5
    command = [sys.executable, "-c", READ_MEASURED, str(toy_folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-500:]
    *refused, peak = done.stdout.splitlines()
    assert len(refused) == 2
    assert all(re.search(rf"announces {values}\d? values, \d+ MiB when read; expected", line) for line in refused)
    assert int(peak) < 2**20


@pytest.mark.parametrize("column", ["object", "contact_links"])
def test_a_long_text_of_many_rows_is_refused_before_it_is_copied_for_each(toy_folder, column):
    """20 kB of a file that are 300 MB when read; of ten times as many rows 3 GB."""
    path = shard_path(toy_folder, NAME)
    table = pq.read_table(path).take(np.zeros(30_000, dtype=np.int64))
    field, text = table.schema.field(column), "a" * 10_000
    texts = pa.array([text if column == "object" else [text]] * len(table), field.type)
    pq.write_table(table.set_column(table.schema.names.index(column), field, texts), path, compression="zstd")
    assert path.stat().st_size < 40_000
    done = subprocess.run(
        [sys.executable, "-c", READ_MEASURED, str(toy_folder)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-500:]
    refused, peak = done.stdout.splitlines()
    assert "MiB of texts when read; expected at most 256 MiB; generate the object again" in refused
    assert int(refused.split(" MiB")[0].split()[-1]) in range(286, 290)
    assert int(peak) < 2**27


def test_texts_that_continue_each_other_are_refused(toy_folder):
    """In the encoding DELTA_BYTE_ARRAY a million texts of 10 kB take as many bytes."""
    path = shard_path(toy_folder, NAME)
    table = pq.read_table(path)
    pq.write_table(table, path, use_dictionary=False, column_encoding={"object": "DELTA_BYTE_ARRAY"})
    with pytest.raises(DamagedShardError, match="texts that continue each other, as no shard has them"):
        read_shard(toy_folder, read_manifest(toy_folder), NAME)


@pytest.mark.parametrize(
    "options", [{"data_page_version": "2.0"}, {"use_dictionary": False}, {"row_group_size": 5}, {"compression": "none"}]
)
def test_shards_that_another_program_wrote_anew_are_read(toy_folder, options):
    path = shard_path(toy_folder, NAME)
    table = pq.read_table(path)
    pq.write_table(table, path, **options)
    assert read_shard(toy_folder, read_manifest(toy_folder), NAME).table.equals(table)


def test_a_column_of_another_type_is_not_read(toy_folder):
    """Values of fixed width may have a megabyte each, and take no more than one of them in the file."""
    path = shard_path(toy_folder, NAME)
    table = pq.read_table(path)
    wide = pa.array([b"x" * 2**10] * len(table), type=pa.binary(2**10))
    place = table.schema.names.index("seed")
    pq.write_table(table.set_column(place, pa.field("seed", wide.type, nullable=False), wide), path)
    with pytest.raises(
        DamagedShardError, match=r"shard-object-0\.parquet has values of another type in seed; generate"
    ):
        read_shard(toy_folder, read_manifest(toy_folder), NAME)


def test_flipped_bits_in_a_footer_are_damage_and_never_end_the_process(toy_folder):
    """Columns asked of pyarrow's metadata abort it where sizes do not fit the schema, which stands first."""
    content = shard_path(toy_folder, NAME).read_bytes()
    draw, begin = random.Random(0), footer_begin(content)
    places = [(begin + bit // 8, bit % 8) for bit in range(0, 3 * FLIPS, 3)]
    places += [(draw.randrange(begin, len(content)), draw.randrange(8)) for _ in range(FLIPS)]
    lines = "".join(f"{at} {bit}\n" for at, bit in places)
    done = subprocess.run(
        [sys.executable, "-c", READ_EACH, str(toy_folder)], input=lines, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-500:]
    outcomes = done.stdout.splitlines()
    assert len(outcomes) == len(places)
    assert set(outcomes) == {"refused", "same"}
