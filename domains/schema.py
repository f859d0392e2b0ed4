"""The columns of a domain's Parquet shards, and how rows become bytes."""

import dataclasses
import io
import json
from collections.abc import Sequence
from typing import Any, Literal

import pyarrow as pa

from gelgap.sim import Diagnostics

SCHEMA_VERSION = 1

OptionalColumn = Literal["height_map", "contact_mask", "marker_rest_mm", "marker_px", "diagnostics"]
"""What a domain may also hold; `diagnostics` is one column for each field of the solver's `Diagnostics`."""

# A row group is what a reader must take from disk to see one frame: small, so that random access stays cheap.
ROWS_PER_GROUP = 32

# 16-bit height maps: 0.1 µm steps from 0.5 mm outwards (the membrane bulges) to 6 mm inwards.
HEIGHT_MAP_STEP_MM = 1e-4
HEIGHT_MAP_OFFSET_MM = -0.5

_PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
_POINTS = pa.list_(pa.list_(pa.float32(), 2))

FRAME_COLUMNS: dict[str, pa.DataType] = {
    "frame_id": pa.int32(),
    "point_id": pa.int32(),
    "contact_class": pa.int32(),
    "depth_mm": pa.float64(),
    "radius_mm": pa.float64(),
    "angle_deg": pa.float64(),
    "trajectory_id": pa.int32(),
    "step": pa.int32(),
    "x_mm": pa.float64(),
    "y_mm": pa.float64(),
    "commanded_z_mm": pa.float64(),
    "shear_x_mm": pa.float64(),
    "shear_y_mm": pa.float64(),
    "fx_n": pa.float64(),
    "fy_n": pa.float64(),
    "fz_n": pa.float64(),
    "converged": pa.bool_(),
    "contact_radius_mm": pa.float64(),
    "split": pa.string(),
    "image": _PICTURE,
}
DIAGNOSTICS_COLUMNS = {
    field.name: pa.int32() if field.type is int else pa.float64() for field in dataclasses.fields(Diagnostics)
}
OPTIONAL_COLUMNS: dict[OptionalColumn, dict[str, pa.DataType]] = {
    "height_map": {"height_map": _PICTURE},
    "contact_mask": {"contact_mask": _PICTURE},
    "marker_rest_mm": {"marker_rest_mm": _POINTS},
    "marker_px": {"marker_px": _POINTS},
    "diagnostics": DIAGNOSTICS_COLUMNS,
}


def frame_schema(optional: Sequence[OptionalColumn] = ()) -> pa.Schema:
    """Return the Arrow schema of a shard, with the metadata by which Hugging Face `datasets` decodes pictures."""
    columns = dict(FRAME_COLUMNS)
    for name, added in OPTIONAL_COLUMNS.items():
        columns |= added if name in optional else {}
    features = {name: _huggingface_feature(kind) for name, kind in columns.items()}
    metadata = {"huggingface": json.dumps({"info": {"features": features}})}
    return pa.schema([pa.field(name, kind) for name, kind in columns.items()], metadata=metadata)


def _huggingface_feature(kind: pa.DataType) -> dict[str, Any]:
    if kind == _PICTURE:
        return {"_type": "Image"}
    if kind == _POINTS:
        pair = {"feature": {"dtype": "float32", "_type": "Value"}, "length": 2, "_type": "List"}
        return {"feature": pair, "_type": "List"}
    names = {pa.float64(): "float64", pa.bool_(): "bool"}
    return {"dtype": names.get(kind, str(kind)), "_type": "Value"}


def encode_shard(rows: Sequence[dict[str, Any]], optional: Sequence[OptionalColumn] = ()) -> bytes:
    """Return the Parquet file (zstd) that holds these rows: the same rows always give the same bytes."""
    import pyarrow.parquet as pq

    table = pa.Table.from_pylist(list(rows), schema=frame_schema(optional))
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        compression="zstd",
        compression_level=1,
        row_group_size=ROWS_PER_GROUP,
        use_dictionary=False,
    )
    return sink.getvalue()


def picture_cell(png: bytes | None) -> dict[str, Any] | None:
    """Return the value of a picture column: the `bytes, path` struct of Hugging Face, or null."""
    return None if png is None else {"bytes": png, "path": None}
