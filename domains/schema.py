"""The Parquet shards of a domain: their Arrow schema, and how rows become bytes."""

import io
import json
from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from gelgap.domains.columns import IMAGE, LABELS, OPTIONAL, PICTURE, POINTS, OptionalColumn

SCHEMA_VERSION = 1
# A row group is what a reader must take from disk to see one frame: small, so that random access stays cheap.
ROWS_PER_GROUP = 32


def frame_schema(optional: Sequence[OptionalColumn] = ()) -> pa.Schema:
    """Return the Arrow schema of a shard, with the metadata by which Hugging Face `datasets` decodes pictures."""
    columns = [
        *LABELS,
        IMAGE,
        *(column for name in OPTIONAL if name in optional for column in OPTIONAL[name]),
    ]
    features = {column.name: _huggingface_feature(column.type) for column in columns}
    metadata = {"huggingface": json.dumps({"info": {"features": features}})}
    return pa.schema([pa.field(column.name, column.type) for column in columns], metadata=metadata)


def _huggingface_feature(kind: pa.DataType) -> dict[str, Any]:
    if kind == PICTURE:
        return {"_type": "Image"}
    if kind == POINTS:
        pair = {"feature": {"dtype": "float32", "_type": "Value"}, "length": 2, "_type": "List"}
        return {"feature": pair, "_type": "List"}
    names = {pa.float64(): "float64", pa.bool_(): "bool"}
    return {"dtype": names.get(kind, str(kind)), "_type": "Value"}


def encode_shard(rows: Sequence[dict[str, Any]], optional: Sequence[OptionalColumn] = ()) -> bytes:
    """Return the Parquet file that holds these rows: the same rows always give the same bytes."""
    import pyarrow.parquet as pq

    table = pa.Table.from_pylist(list(rows), schema=frame_schema(optional))
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        compression=_compression(optional),
        row_group_size=ROWS_PER_GROUP,
        use_dictionary=False,
    )
    return sink.getvalue()


def _compression(optional: Sequence[OptionalColumn]) -> dict[str, str]:
    """Return the codec of columns by their paths: labels are few, and noise leaves pictures nothing to gain."""
    leaves = {PICTURE: "bytes", POINTS: "list.element.list.element"}
    columns = (column for name in optional for column in OPTIONAL[name] if column.type in leaves)
    return {f"{column.name}.{leaves[column.type]}": "zstd" for column in columns}
