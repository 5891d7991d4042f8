"""What a footer announces is read as pyarrow reads it; a damaged one is refused, and never ends the process."""

import random
import struct
import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dexnudge.dataset.parquet_footer import announced_sizes
from dexnudge.dataset.shards import shard_path

NAME = "object-0"
FLIPS = 600
READ_EACH = """
import sys
from pathlib import Path
from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.shards import read_shard, shard_path
from dexnudge.errors import DatasetError

folder = Path(sys.argv[1])
manifest, path = read_manifest(folder), shard_path(folder, "object-0")
whole, good = path.read_bytes(), read_shard(folder, manifest, "object-0")
for line in sys.stdin:
    at, bit = map(int, line.split())
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :])
    try:
        shard = read_shard(folder, manifest, "object-0")
    except DatasetError as error:
        print("refused" if str(path) in str(error) else f"refused without its name: {error}")
    else:
        same = shard.table.equals(good.table) and (shard.counts, shard.mesh_hash) == (good.counts, good.mesh_hash)
        print("same" if same else f"another shard after a flip at {at} {bit}")
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
    ],
    ids=["empty", "number", "nested lists", "nested structures", "a list without end", "a text without end"],
)
def test_what_is_no_footer_is_refused(tmp_path, footer):
    path = tmp_path / "t.parquet"
    path.write_bytes(b"PAR1" + footer + struct.pack("<I", len(footer)) + b"PAR1")
    with pytest.raises(ValueError, match="its footer"):
        announced_sizes(path)
    path.write_bytes(b"PAR1")
    with pytest.raises(ValueError, match="it has no footer"):
        announced_sizes(path)


def test_flipped_bits_in_a_footer_never_end_the_process(toy_folder):
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
