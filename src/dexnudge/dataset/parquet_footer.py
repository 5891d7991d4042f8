"""What a Parquet file announces, read here: pyarrow ends the process at some damaged footers, and makes room for all.

The footer is a `FileMetaData` in Thrift's compact protocol, then its size (4 bytes, little-endian) and "PAR1"; before
each page stands a `PageHeader`: https://github.com/apache/parquet-format, `parquet.thrift`.
"""

from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

MAGIC = b"PAR1"
LARGEST_FOOTER = 2**20  # bytes; those of shards have some 10,000, and each may become a structure of 70
DEEPEST = 32  # lists and structures within each other; Parquet's own end at 12
TRUE, FALSE, BYTE, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
I16, I32, I64 = 4, 5, 6
LAST_FIELD = 2**15 - 1  # beyond it, Thrift's 16 bits begin again
ROW_GROUPS, COLUMNS, NUM_ROWS, META_DATA, NUM_VALUES = 4, 1, 3, 3, 5  # numbers of fields, in their structures
UNCOMPRESSED, COMPRESSED, DATA_PAGE, DICTIONARY_PAGE = 6, 7, 9, 11  # of a chunk: its sizes, and where its pages begin
PAGE_UNCOMPRESSED, PAGE_COMPRESSED = 2, 3
DICTIONARY_CONTENT = 7
# Fields of a page's header that hold a number of values, and where its encoding stands.
PAGE_CONTENTS = {5: 2, DICTIONARY_CONTENT: 2, 8: 4}
# Each text may begin as the one before it: the only encoding whose pages do not hold what they unpack to.
DELTA_BYTE_ARRAY = 7
LARGEST_PAGE_HEADER = 2**16  # bytes; some 50, and two texts of statistics
MOST_PAGES = 10_000  # of a file; a shard has one of each MiB, and two a column


def announced_sizes(path: Path) -> list[tuple[int, int]]:
    """Return (number of values, bytes when unpacked) of each column of each row group.

    Footer and pages both say so, and pyarrow makes room for what either says: it is the greater.

    Raises:
        ValueError: no footer, or one that cannot be read, or pages that cannot.
    """
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(max(end - 8, 0))
        tail = file.read(8)
        size = int.from_bytes(tail[:4], "little")
        if tail[4:] != MAGIC or size > min(end - 8, LARGEST_FOOTER):
            raise ValueError("it has no footer")
        file.seek(end - 8 - size)
        try:
            groups = _field(_Thrift(file.read(size), I64).struct(), ROW_GROUPS, list)
            sizes, left = [], MOST_PAGES
            for group in groups:
                rows = abs(_field(group, NUM_ROWS, int))
                for chunk in _field(group, COLUMNS, list):
                    content = _field(chunk, META_DATA, dict)
                    values = max(rows, abs(_field(content, NUM_VALUES, int)))
                    pages = _pages(file, content, left) if values else []
                    left -= len(pages)
                    unpacked = max(abs(_field(content, UNCOMPRESSED, int)), sum(page.unpacked for page in pages))
                    held = [sum(page.values for page in pages if page.dictionary is own) for own in (False, True)]
                    sizes.append((max(values, *held), unpacked))
        except (IndexError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"its footer or a page is damaged: {error}") from error
    return sizes


class _Page(NamedTuple):
    """What the header of a page says; `dictionary`: its values are those that others refer to."""

    values: int
    unpacked: int
    dictionary: bool


def _pages(file: BinaryIO, chunk: dict[int, Any], most: int) -> list[_Page]:
    """Return the pages of a column; ValueError for more than `most`."""
    place = _field(chunk, DATA_PAGE, int)
    if DICTIONARY_PAGE in chunk and 0 < _field(chunk, DICTIONARY_PAGE, int) < place:
        place = chunk[DICTIONARY_PAGE]
    end = place + _field(chunk, COMPRESSED, int)
    pages: list[_Page] = []
    while place < end:
        if len(pages) == most or place < 0:
            raise ValueError(f"more than {MOST_PAGES} pages, or one before its beginning")
        file.seek(place)
        header = _Thrift(file.read(LARGEST_PAGE_HEADER), I32)
        fields = header.struct()
        contents = {kind: _field(fields, kind, dict) for kind in PAGE_CONTENTS if kind in fields}
        if any(content.get(PAGE_CONTENTS[kind]) == DELTA_BYTE_ARRAY for kind, content in contents.items()):
            raise ValueError("texts that continue each other, as no shard has them")
        values = sum(abs(_field(content, 1, int)) for content in contents.values())
        pages.append(_Page(values, abs(_field(fields, PAGE_UNCOMPRESSED, int)), DICTIONARY_CONTENT in contents))
        place += header.read + abs(_field(fields, PAGE_COMPRESSED, int))
    return pages


def _field(values: dict[int, Any], number: int, kind: type) -> Any:
    """The value of a field; TypeError where it is of another kind, which other readers pass over."""
    if not isinstance(values[number], kind):
        raise TypeError(f"field {number} has another type than Parquet's")
    return values[number]


class _Thrift:
    """Reads values one after another; IndexError at the end, ValueError for what the protocol does not have.

    Structures, lists of structures and integers of the kind `numbers` are returned, all else is None.
    read: bytes so far.
    """

    def __init__(self, data: bytes, numbers: int) -> None:
        self._data, self._numbers, self.read = data, numbers, 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Return the values of a structure, by the numbers of their fields."""
        values: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            if number in values or not 0 < number <= LAST_FIELD:  # other readers take another one than this
                raise ValueError(f"field {number} where it cannot be")
            kind = head & 15
            values[number] = None if kind in (TRUE, FALSE) else self._value(kind, depth + 1)
        return values

    def _value(self, kind: int, depth: int) -> Any:
        if depth > DEEPEST:
            raise ValueError(f"more than {DEEPEST} structures within each other")
        if kind in (I16, I32, I64):
            value = self._integer()
            return value if kind == self._numbers else None
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
        raise ValueError(f"a value of the unknown kind {kind}")

    def _skip(self, count: int) -> None:
        self._check_left(count)
        self.read += count

    def _check_left(self, count: int) -> None:
        if count > len(self._data) - self.read:
            raise IndexError(f"{count} values or bytes in the last {len(self._data) - self.read}")

    def _byte(self) -> int:
        self.read += 1
        return self._data[self.read - 1]

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):  # 64 bits
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("a number of more than 64 bits")

    def _integer(self) -> int:
        """A number with sign: 0, -1, 1, -2, ... are written as 0, 1, 2, 3."""
        value = self._varint()
        return (value >> 1) ^ -(value & 1)
