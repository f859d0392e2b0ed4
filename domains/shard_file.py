"""Reading a Parquet shard that anyone may have written: nothing in it takes more memory than generation's shards do."""

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.domains.columns import IMAGE, LABELS, OPTIONAL, LabelColumn
from gelgap.domains.page_headers import plain_pages

if TYPE_CHECKING:
    import pyarrow as pa
    from pyarrow.parquet import ColumnChunkMetaData, ParquetFile

# More rows than any shard has; a few bytes of Parquet can claim billions.
_MOST_ROWS = 100_000
# More entries than any list in the footer has, and more bytes than any text there.
_FOOTER_LIMITS = {"thrift_container_size_limit": 10_000, "thrift_string_size_limit": 2**20}
# A label is a number or the name of a part.
_LABEL_BYTES, _HEADER_BYTES = 64, 2**16
# Coded pictures hardly become smaller; those that are nearly empty do, but are small.
_MOST_GROWTH, _SMALL_BYTES = 8, 2**25

_OPTIONAL = [column for columns in OPTIONAL.values() for column in columns]
_KNOWN = {column.name: column for column in (*LABELS, IMAGE, *_OPTIONAL)}


class ShardFile:
    """One shard, memory-mapped. Every method raises RuntimeError, which names the file, where it is damaged."""

    def __init__(self, path: Path):
        self.path = path

    @property
    def schema(self) -> "pa.Schema":
        """The columns, as they lie in the file."""
        return self._file.schema_arrow

    @cached_property
    def rows_per_group(self) -> tuple[int, ...]:
        """The number of frames in each row group."""
        metadata = self._file.metadata
        return tuple(metadata.row_group(group).num_rows for group in range(metadata.num_row_groups))

    def labels(self) -> dict[str, np.ndarray]:
        """Return the columns that are made from the contact alone, by name, (n,)."""
        names = [name for name in self.schema.names if isinstance(_KNOWN[name], LabelColumn)]
        table = self._read(names, range(len(self.rows_per_group)))
        return {name: table[name].to_numpy() for name in names}

    def cells(self, group: int, column: str) -> list[Any]:
        """Return a column's values in one row group; of pictures their bytes."""
        import pyarrow as pa

        cells = self._read([column], [group])[column]
        if pa.types.is_struct(cells.type):
            return [cell for chunk in cells.chunks for cell in chunk.field("bytes").to_pylist()]
        return cells.to_pylist()

    def table(self) -> "pa.Table":
        """Return the whole shard."""
        return self._read(self.schema.names, range(len(self.rows_per_group)))

    @cached_property
    def _bytes(self) -> "pa.Buffer":
        import pyarrow as pa

        return pa.memory_map(str(self.path)).read_buffer()

    @cached_property
    def _file(self) -> "ParquetFile":
        """The file, after its footer has been checked."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            file = pq.ParquetFile(pa.BufferReader(self._bytes), **_FOOTER_LIMITS)
            _check_footer(file)
        except (OSError, ValueError, KeyError, MemoryError, pa.ArrowException) as error:
            raise damaged(self.path, str(error)) from None
        return file

    def _read(self, names: list[str], groups: "range | list[int]") -> "pa.Table":
        import pyarrow as pa

        try:
            for group in groups:
                self._check_pages(names, group)
            return self._file.read_row_groups(list(groups), columns=names)
        except (OSError, ValueError, KeyError, MemoryError, pa.ArrowException) as error:
            raise damaged(self.path, str(error)) from None

    def _check_pages(self, names: list[str], group: int) -> None:
        """Raise ValueError if the pages of a row group state more values or bytes than generation writes."""
        rows = self._file.metadata.row_group(group)
        wanted = set(names)
        for number in range(rows.num_columns):
            chunk = rows.column(number)
            name = chunk.path_in_schema.partition(".")[0]
            if name in wanted:
                self._check_chunk(chunk, _KNOWN[name], rows.num_rows)

    def _check_chunk(self, chunk: "ColumnChunkMetaData", column: Any, rows: int) -> None:
        if chunk.has_dictionary_page:
            raise ValueError(f"column {column.name} has a dictionary")
        start, stop = chunk.data_page_offset, chunk.data_page_offset + chunk.total_compressed_size
        if not 0 < start <= stop <= self._bytes.size:
            raise ValueError(f"column {column.name} lies outside of the file")
        values = plain_bytes = 0
        for page in plain_pages(memoryview(self._bytes).cast("B")[start:stop]):
            values += page.values
            plain_bytes += page.plain_bytes
        if isinstance(column, LabelColumn):
            most_bytes, most_values = _HEADER_BYTES + _LABEL_BYTES * rows, rows
        else:
            most_bytes = max(_SMALL_BYTES, _MOST_GROWTH * (stop - start))
            most_values = rows + plain_bytes
        if plain_bytes > most_bytes:
            raise ValueError(f"column {column.name} would take {plain_bytes / 2**20:.0f} MiB")
        if values != chunk.num_values or values > most_values:
            raise ValueError(f"column {column.name} states {max(values, chunk.num_values)} values")


def _check_footer(file: "ParquetFile") -> None:
    """Raise ValueError if a shard has not the rows and columns that generation writes."""
    metadata = file.metadata
    groups = [metadata.row_group(number).num_rows for number in range(metadata.num_row_groups)]
    if min(groups, default=0) < 0 or sum(groups) != metadata.num_rows or metadata.num_rows > _MOST_ROWS:
        raise ValueError(f"it states {max([metadata.num_rows, *groups])} rows")
    schema = file.schema_arrow
    for name in schema.names:
        if name not in _KNOWN or schema.names.count(name) > 1:
            raise ValueError(f"column {name[:40]!r} is unknown or there twice")
    required = [column.name for column in (*LABELS, IMAGE)]
    for name in dict.fromkeys([*required, *schema.names]):
        if name not in schema.names or schema.field(name).type != _KNOWN[name].type:
            raise ValueError(f"column {name} is missing or not {_KNOWN[name].type}")


def damaged(path: Path, problem: str) -> RuntimeError:
    """Return the error that names a shard, what is wrong with it and what to do."""
    problem = " ".join(problem.split())
    return RuntimeError(
        f"{path} is damaged ({problem}): run the same `gelgap generate` again to repair it; "
        f"`gelgap inspect {path.parent} --verify` names all damage"
    )
