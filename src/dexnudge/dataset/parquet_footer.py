"""What a Parquet file announces, read from its footer alone: pyarrow ends the process at some damaged ones.

The footer is a `FileMetaData` in Thrift's compact protocol, then its size (4 bytes, little-endian) and "PAR1":
https://github.com/apache/parquet-format, `parquet.thrift`.
"""

from pathlib import Path
from typing import Any

MAGIC = b"PAR1"
LARGEST_FOOTER = 2**20  # bytes; those of shards have some 10,000, and each may become a structure of 70
DEEPEST = 32  # lists and structures within each other; Parquet's own end at 12
TRUE, FALSE, BYTE, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
I16, I32, I64 = 4, 5, 6
LAST_FIELD = 2**15 - 1  # beyond it, Thrift's 16 bits begin again
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
        groups = _field(footer.struct(), ROW_GROUPS, list)
        chunks = [_field(chunk, META_DATA, dict) for group in groups for chunk in _field(group, COLUMNS, list)]
        return [(abs(_field(chunk, NUM_VALUES, int)), abs(_field(chunk, UNCOMPRESSED, int))) for chunk in chunks]
    except (IndexError, KeyError, TypeError) as error:
        raise ValueError(f"its footer is damaged ({error!r})") from error


def _field(values: dict[int, Any], number: int, kind: type) -> Any:
    """The value of a field; TypeError where it is of another kind, which other readers pass over."""
    if not isinstance(values[number], kind):
        raise TypeError(f"field {number} has another type than Parquet's")
    return values[number]


class _Footer:
    """Reads values one after another; IndexError at the end, ValueError for what the protocol does not have.

    Structures, lists of structures and integers of 64 bits are returned, all else is None.
    """

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Return the values of a structure, by the numbers of their fields."""
        values: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            if number in values or not 0 < number <= LAST_FIELD:  # other readers take another one than this
                raise ValueError(f"its footer has field {number} where it cannot be")
            kind = head & 15
            values[number] = None if kind in (TRUE, FALSE) else self._value(kind, depth + 1)
        return values

    def _value(self, kind: int, depth: int) -> Any:
        if depth > DEEPEST:
            raise ValueError(f"its footer nests more than {DEEPEST} deep")
        if kind in (I16, I32, I64):
            value = self._integer()
            return value if kind == I64 else None
        if kind == BINARY:
            return self._skip(self._varint())
        if kind == STRUCT:
            return self.struct(depth)
        if kind in (LIST, SET):
            head = self._byte()
            count = head >> 4 if head >> 4 < 15 else self._varint()
            self._check_left(count)  # each takes a byte at least
            values = [self._value(head & 15, depth + 1) for _ in range(count)]
            return values if (kind, head & 15) == (LIST, STRUCT) else None
        if kind in (TRUE, FALSE, BYTE):  # booleans of lists take a byte each
            return self._skip(1)
        if kind == DOUBLE:
            return self._skip(8)
        raise ValueError(f"its footer has a value of the unknown kind {kind}")

    def _skip(self, count: int) -> None:
        self._check_left(count)
        self._at += count

    def _check_left(self, count: int) -> None:
        if count > len(self._data) - self._at:
            raise IndexError(f"{count} values or bytes in the last {len(self._data) - self._at}")

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
