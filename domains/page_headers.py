"""What the pages of a Parquet file say of themselves, read before any of them is decompressed.

A page's header states its size when decompressed, and a reader takes that much memory. Headers are structures of
Thrift's compact protocol (Apache Parquet, parquet.thrift: PageHeader).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

_DATA_PAGE, _PLAIN = 0, 0
# Thrift's kinds of values; a page's header has no others.
_TRUE, _FALSE, _BYTE, _INTEGERS, _BINARY, _STRUCT = 1, 2, 3, (4, 5, 6), 8, 12
_DEEPEST = 3  # header, header of a data page, statistics
_LONGEST_INTEGER = 10


@dataclass(frozen=True)
class Page:
    """One page: how many values it holds, and its size before compression."""

    values: int
    plain_bytes: int


def plain_pages(data: memoryview) -> Iterator[Page]:
    """Yield the pages of a column chunk, which are one after the other in its bytes.

    Raises
    ------
    ValueError
        If they are not data pages in the encoding PLAIN: a dictionary or a delta makes many bytes of few.
    """
    place = 0
    while place < len(data):
        cursor = _Cursor(data, place)
        try:
            header = cursor.struct()
            kind, plain_bytes, packed_bytes = (header[number] for number in (1, 2, 3))
            values, encoding = (header[5][number] for number in (1, 2)) if kind == _DATA_PAGE else (0, None)
        except (IndexError, KeyError, TypeError):
            raise ValueError("the header of a page is damaged") from None
        if (kind, encoding) != (_DATA_PAGE, _PLAIN):
            raise ValueError("a page is not plain data")
        place = cursor.place + packed_bytes
        if min(plain_bytes, packed_bytes, values) < 0 or place > len(data):
            raise ValueError("a page states a size that is not possible")
        yield Page(values, plain_bytes)


class _Cursor:
    """A place in the bytes of Thrift's compact protocol; each method reads on from it."""

    def __init__(self, data: memoryview, place: int):
        self.data, self.place = data, place

    def struct(self, depth: int = 1) -> dict[int, Any]:
        """Return the fields of a structure by their number."""
        if depth > _DEEPEST:
            raise ValueError("the header of a page is nested too deeply")
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            number = number + step if step else self._integer()
            fields[number] = self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (_TRUE, _FALSE):
            return kind == _TRUE
        if kind == _BYTE:
            return self._byte()
        if kind in _INTEGERS:
            return self._integer()
        if kind == _BINARY:
            length = self._unsigned()
            self.place += length
            return None
        if kind == _STRUCT:
            return self.struct(depth + 1)
        raise ValueError("the header of a page has a field of an unknown kind")

    def _byte(self) -> int:
        self.place += 1
        return self.data[self.place - 1]

    def _unsigned(self) -> int:
        value = 0
        for index in range(_LONGEST_INTEGER):
            byte = self._byte()
            value |= (byte & 127) << 7 * index
            if byte < 128:
                return value
        raise ValueError("the header of a page has an endless number")

    def _integer(self) -> int:
        value = self._unsigned()
        return value >> 1 ^ -(value & 1)
