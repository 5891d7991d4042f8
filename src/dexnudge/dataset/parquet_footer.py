"""What a Parquet file announces, read from its footer alone: pyarrow ends the process at some damaged ones.

The footer is a `FileMetaData` in Thrift's compact protocol, then its size (4 bytes, little-endian) and "PAR1":
https://github.com/apache/parquet-format, `parquet.thrift`.
"""

from pathlib import Path
from typing import Any

MAGIC = b"PAR1"
LARGEST_FOOTER = 2**24  # bytes; those of shards have some 10,000
DEEPEST = 32  # lists and structures within each other; Parquet's own end at 12
TRUE, FALSE, BYTE, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
VARINTS = (4, 5, 6)  # integers of 16, 32 and 64 bits
ROW_GROUPS, COLUMNS, META_DATA, NUM_VALUES, UNCOMPRESSED = 4, 1, 3, 5, 6  # numbers of fields, in their structures


def announced_sizes(path: Path) -> list[tuple[int, int]]:
    """Return (number of values, bytes when unpacked) of each column of each row group.

    Raises:
        ValueError: no footer, or one that cannot be read.
    """
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(max(end - 8, 0))
        tail = file.read(8)
        size = int.from_bytes(tail[:4], "little")
        if tail[4:] != MAGIC or size > min(end - 8, LARGEST_FOOTER):
            raise ValueError("it has no footer")
        file.seek(end - 8 - size)
        footer = _Footer(file.read(size))
    try:
        chunks = [chunk[META_DATA] for group in footer.struct()[ROW_GROUPS] for chunk in group[COLUMNS]]
        return [(abs(chunk[NUM_VALUES]), abs(chunk[UNCOMPRESSED])) for chunk in chunks]
    except (IndexError, KeyError, TypeError) as error:
        raise ValueError(f"its footer is damaged ({error!r})") from error


class _Footer:
    """Reads values one after another; IndexError at the end, ValueError for what the protocol does not have."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Return the values of a structure, by the numbers of their fields."""
        values: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            values[number] = kind == TRUE if kind in (TRUE, FALSE) else self._value(kind, depth + 1)
        return values

    def _value(self, kind: int, depth: int) -> Any:
        if depth > DEEPEST:
            raise ValueError(f"its footer nests more than {DEEPEST} deep")
        if kind in VARINTS:
            return self._integer()
        if kind == BINARY:
            return self._skip(self._varint())
        if kind == STRUCT:
            return self.struct(depth)
        if kind in (LIST, SET):
            head = self._byte()
            count = head >> 4 if head >> 4 < 15 else self._varint()
            return [self._value(head & 15, depth + 1) for _ in range(count)]
        if kind in (TRUE, FALSE, BYTE):  # booleans of lists take a byte each
            return self._byte()
        if kind == DOUBLE:
            return self._skip(8)
        raise ValueError(f"its footer has a value of the unknown kind {kind}")

    def _skip(self, count: int) -> None:
        self._at += count

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):  # 64 bits
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("its footer has a number of more than 64 bits")

    def _integer(self) -> int:
        """A number with sign: 0, -1, 1, -2, ... are written as 0, 1, 2, 3."""
        value = self._varint()
        return (value >> 1) ^ -(value & 1)
