"""Parquet files whose footers say other numbers than hold."""

import io
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

ONE_LIST = 40_000_003  # numbers of one row, which repeat and take no room


def varint(number: int, length: int = 1) -> bytes:
    """A number of Thrift's compact protocol, in `length` bytes or more."""
    number = 2 * number
    parts = [number >> shift & 127 for shift in range(0, max(7 * length, number.bit_length()), 7)]
    return bytes([*(part | 128 for part in parts[:-1]), parts[-1]])


def with_number(content: bytes, old: int, new: int) -> bytes:
    """Return the file with another number where its footer says `old`."""
    size = struct.unpack("<I", content[-8:-4])[0]
    footer = content[-8 - size : -8]
    assert varint(old) in footer
    footer = footer.replace(varint(old), varint(new, len(varint(old))))
    return content[: -8 - size] + footer + struct.pack("<I", len(footer)) + b"PAR1"


def more_rows(header: dict[bytes, bytes]) -> bytes:
    """A file that says that it has 8 GB of rows."""
    file = io.BytesIO()
    pq.write_table(pa.table({"x": np.zeros(70_001)}).replace_schema_metadata(header), file)
    return with_number(file.getvalue(), 70_001, 10**9)


def one_list(header: dict[bytes, bytes]) -> bytes:
    """A file of 600 bytes that takes 900 MB, and says that it has 100 values."""
    file = io.BytesIO()
    one = pa.table({"x": pa.array([np.zeros(ONE_LIST, dtype=np.float32)], pa.list_(pa.float32()))})
    pq.write_table(one.replace_schema_metadata(header), file, data_page_size=2**31 - 1, row_group_size=ONE_LIST)
    return with_number(file.getvalue(), ONE_LIST, 100)
