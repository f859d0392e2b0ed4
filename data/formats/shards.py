"""Parquet shards: the columns of a domain with type, unit and meaning, and shards as bytes.

A new column is one entry here, and one in `gelgap.domains.generation.columns`, which makes it.
"""

import io
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gelgap.data.formats.optional_columns import OptionalColumn
from gelgap.data.formats.pictures import encode_png

SCHEMA_VERSION = 1
# A row group is what a reader must take from disk to see one frame: small, so that random access stays cheap.
ROWS_PER_GROUP = 32


class Kind(NamedTuple):
    """How a column's type is called: the feature of Hugging Face `datasets`, and its leaf in Parquet."""

    feature: dict[str, Any]
    leaf: str = ""


_INT, _FLOAT, _BOOL, _TEXT = pa.int32(), pa.float64(), pa.bool_(), pa.string()
PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""A picture as Hugging Face `datasets` reads it."""
POINTS = pa.list_(pa.list_(pa.float32(), 2))
FORCES = pa.list_(pa.float32())
_NUMBER = {"dtype": "float32", "_type": "Value"}
_PAIR = {"feature": _NUMBER, "length": 2, "_type": "List"}
KINDS = {
    _INT: Kind({"dtype": "int32", "_type": "Value"}),
    _FLOAT: Kind({"dtype": "float64", "_type": "Value"}),
    _BOOL: Kind({"dtype": "bool", "_type": "Value"}),
    _TEXT: Kind({"dtype": "string", "_type": "Value"}),
    PICTURE: Kind({"_type": "Image"}, "bytes"),
    POINTS: Kind({"feature": _PAIR, "_type": "List"}, "list.element.list.element"),
    FORCES: Kind({"feature": _NUMBER, "_type": "List"}, "list.element"),
}
"""Every type that a column may have."""

# 16-bit height maps: 0.1 µm steps from 0.5 mm outwards (the membrane bulges) to 6 mm inwards.
HEIGHT_MAP_STEP_MM = 1e-4
HEIGHT_MAP_OFFSET_MM = -0.5
TRACTION_SHAPE = (24, 32)
"""Rows and columns of the cells on which the column `traction` has forces."""


@dataclass(frozen=True)
class Column:
    """A column of the Parquet shards; one that is no label is null in frames without a picture."""

    name: str
    type: pa.DataType
    unit: str
    meaning: str

    @property
    def is_label(self) -> bool:
        """Whether every frame has a value, made from the contact alone and not by the renderer."""
        return self.type not in (PICTURE, POINTS, FORCES)


def height_codes(height_mm: np.ndarray) -> np.ndarray:
    """Return heights (h, w) as uint16 codes of a map; a ValueError if one lies beyond them."""
    codes = np.rint((height_mm - HEIGHT_MAP_OFFSET_MM) / HEIGHT_MAP_STEP_MM)
    if codes.min() < 0 or codes.max() > 65535:
        most_mm = HEIGHT_MAP_OFFSET_MM + 65535 * HEIGHT_MAP_STEP_MM
        raise ValueError(
            f"a 16-bit height map holds {HEIGHT_MAP_OFFSET_MM:g} to {most_mm:.2f} mm, and heights are "
            f"{height_mm.min():.2f} to {height_mm.max():.2f} mm"
        )
    return codes.astype(np.uint16)


def picture_cell(picture: np.ndarray) -> dict[str, Any]:
    """Return the value of a picture column."""
    return {"bytes": encode_png(picture), "path": None}


_CLASS = "0 without contact; −1 off the paper's grid"
_DIRECTION = "commanded direction of the travel; null without travel"
_RADIUS = "deformed radius where the normal pressure vanishes"
HEIGHT_MAP_SCALE = (
    f"height towards the camera in mm is {HEIGHT_MAP_OFFSET_MM:g} + {HEIGHT_MAP_STEP_MM:g} × code"
)
_REST = "(x, y) of each dot on the undeformed membrane"
_SEEN = "(x, y) of each dot in the picture, pixel centres at +0.5"
_TORQUE = "torque of the indenter on the sensor about the contact point on the undeformed membrane"
_TURN = "commanded rotation vector of the indenter, along"
_TRACTION = "force (Fx, Fy, Fz) on each cell of 24 rows × 32 columns of the view; null without a picture"
LABELS = (
    Column("frame_id", _INT, "", "position on the path"),
    Column("point_id", _INT, "", "number of the contact point"),
    Column("contact_class", _INT, "", _CLASS),
    Column("depth_mm", _FLOAT, "mm", "commanded depth"),
    Column("radius_mm", _FLOAT, "mm", "commanded travel sideways"),
    Column("angle_deg", _FLOAT, "°", _DIRECTION),
    Column("trajectory_id", _INT, "", "travel at one point, depth and direction"),
    Column("step", _INT, "", "place on the trajectory"),
    Column("x_mm", _FLOAT, "mm", "commanded contact point, to the right"),
    Column("y_mm", _FLOAT, "mm", "commanded contact point, down"),
    Column("commanded_z_mm", _FLOAT, "mm", "minus the depth"),
    Column("shear_x_mm", _FLOAT, "mm", "commanded travel along x"),
    Column("shear_y_mm", _FLOAT, "mm", "commanded travel along y"),
    Column("fx_n", _FLOAT, "N", "force of the indenter on the sensor"),
    Column("fy_n", _FLOAT, "N", "force of the indenter on the sensor"),
    Column("fz_n", _FLOAT, "N", "the same; ≤ 0 in compression"),
    Column("converged", _BOOL, "", "false: no picture"),
    Column("contact_radius_mm", _FLOAT, "mm", _RADIUS),
    Column("split", _TEXT, "", "train, validation or test"),
)
IMAGE = Column("image", PICTURE, "", "what the camera sees")

_HOW = "how the pose was solved"
_DIAGNOSTICS = (
    Column("residual", _FLOAT, "", _HOW),
    Column("iterations", _INT, "", _HOW),
    Column("sticking_fraction", _FLOAT, "", _HOW),
    Column("slip_mm", _FLOAT, "", _HOW),
    Column("elastic_energy_mj", _FLOAT, "", _HOW),
    Column("min_volume_ratio", _FLOAT, "", _HOW),
    Column("imbalance", _FLOAT, "", _HOW),
    Column("coulomb_excess", _FLOAT, "", _HOW),
    Column("tension", _FLOAT, "", _HOW),
    Column("fz_error_n", _FLOAT, "", _HOW),
    Column("shear_error_n", _FLOAT, "", _HOW),
    Column("tz_error_n_mm", _FLOAT, "", _HOW),
    Column("contact_radius_error_mm", _FLOAT, "", _HOW),
    Column("membrane_error_mm", _FLOAT, "", _HOW),
    Column("coarse", _BOOL, "", _HOW),
    Column("folded", _BOOL, "", _HOW),
)
"""Of a solver's `Diagnostics`, field by field."""

OPTIONAL: dict[OptionalColumn, tuple[Column, ...]] = {
    "height_map": (Column("height_map", PICTURE, "mm", HEIGHT_MAP_SCALE),),
    "contact_mask": (Column("contact_mask", PICTURE, "", "255 where the indenter touches"),),
    "marker_rest_mm": (Column("marker_rest_mm", POINTS, "mm", _REST),),
    "marker_px": (Column("marker_px", POINTS, "px", _SEEN),),
    "diagnostics": _DIAGNOSTICS,
    "indenter": (Column("indenter", _TEXT, "", "shape and size of the indenter"),),
    "torque": tuple(Column(f"t{axis}_n_mm", _FLOAT, "N mm", _TORQUE) for axis in "xyz"),
    "traction": (Column("traction_n", FORCES, "N", _TRACTION),),
    "turn": (
        Column("roll_x_deg", _FLOAT, "°", f"{_TURN} x"),
        Column("roll_y_deg", _FLOAT, "°", f"{_TURN} y"),
        Column("twist_deg", _FLOAT, "°", f"{_TURN} z"),
    ),
}
"""The columns by which each `OptionalColumn` is stored."""

COLUMNS = {column.name: column for column in (*LABELS, IMAGE, *(c for own in OPTIONAL.values() for c in own))}
"""Every column that there is, by its name."""


def encode_shard(rows: Sequence[dict[str, Any]], optional: Sequence[OptionalColumn] = ()) -> bytes:
    """Return the Parquet file that holds these rows: the same rows always give the same bytes.

    Its metadata tell Hugging Face `datasets` which columns are pictures.
    """
    chosen = [column for name in OPTIONAL if name in optional for column in OPTIONAL[name]]
    columns = [*LABELS, IMAGE, *chosen]
    features = {column.name: KINDS[column.type].feature for column in columns}
    metadata = {"huggingface": json.dumps({"info": {"features": features}})}
    schema = pa.schema([pa.field(column.name, column.type) for column in columns], metadata=metadata)
    # Labels are few, and noise leaves pictures nothing to gain: only optional columns are compressed.
    leaves = (f"{column.name}.{leaf}" for column in chosen if (leaf := KINDS[column.type].leaf))
    options = {"row_group_size": ROWS_PER_GROUP, "use_dictionary": False}
    sink = io.BytesIO()
    pq.write_table(
        pa.Table.from_pylist(list(rows), schema), sink, compression=dict.fromkeys(leaves, "zstd"), **options
    )
    return sink.getvalue()


# More rows than any shard has; a few bytes of Parquet can claim billions.
_MOST_ROWS = 100_000
# More entries than any list in the footer has, and more bytes than any text there.
_FOOTER_LIMITS = {"thrift_container_size_limit": 10_000, "thrift_string_size_limit": 2**20}
# Labels are few, and coded pictures hardly become smaller; those that are nearly empty do, but are small.
_MOST_GROWTH, _SMALL_BYTES = 8, 2**25


class ShardFile:
    """One shard, memory-mapped. Every method raises RuntimeError, which names the file, where it is damaged.

    A shard that anyone may have written is read only if its footer states the columns that generation writes, and no
    more rows and bytes than generation's shards have.
    """

    def __init__(self, path: Path):
        self.path = path
        self._kept: tuple[tuple[int, str] | None, list[Any]] = (None, [])

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "_kept": (None, [])}

    @property
    def schema(self) -> pa.Schema:
        """The columns, as they lie in the file."""
        return self._file.schema_arrow

    def table(self, names: Sequence[str] | None = None) -> pa.Table:
        """Return the columns of these names, or the whole shard."""
        with self._named_if_damaged():
            return self._file.read(columns=names)

    def cell(self, row: int, column: str) -> Any:
        """Return one value of a column, of a picture its bytes; its row group is kept for the next one."""
        group = int(np.searchsorted(self._ends, row, side="right"))
        if self._kept[0] != (group, column):
            with self._named_if_damaged():
                cells = self._file.read_row_group(group, columns=[column])[column]
            if pa.types.is_struct(cells.type):
                cells = pa.chunked_array([chunk.field("bytes") for chunk in cells.chunks])
            self._kept = ((group, column), cells.to_pylist())
        return self._kept[1][row - int(self._ends[group])]  # counted from the group's end

    @cached_property
    def _ends(self) -> np.ndarray:
        """The row after the last of each row group."""
        groups = map(self._file.metadata.row_group, range(self._file.metadata.num_row_groups))
        return np.cumsum([group.num_rows for group in groups])

    @cached_property
    def _file(self) -> pq.ParquetFile:
        with self._named_if_damaged():
            file = pq.ParquetFile(pa.memory_map(str(self.path)), **_FOOTER_LIMITS)
            _check_footer(file)
        return file

    @contextmanager
    def _named_if_damaged(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, KeyError, MemoryError, pa.ArrowException) as error:
            raise damaged(self.path, str(error)) from None


def _check_footer(file: pq.ParquetFile) -> None:
    """Raise ValueError if a shard states other columns, more rows or more bytes than generation writes."""
    metadata, schema = file.metadata, file.schema_arrow
    names, needed = set(schema.names), {column.name for column in (*LABELS, IMAGE)}
    are_known = names <= COLUMNS.keys() and all(own.type == COLUMNS[own.name].type for own in schema)
    if len(names) < len(schema) or not needed <= names or not are_known:
        raise ValueError("its columns are not those of a domain")
    if not 0 <= metadata.num_rows <= _MOST_ROWS:
        raise ValueError(f"it states {metadata.num_rows} rows")
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        for chunk in map(group.column, range(group.num_columns)):
            n_bytes = chunk.total_uncompressed_size
            most_bytes = max(_SMALL_BYTES, _MOST_GROWTH * chunk.total_compressed_size)
            most_values = group.num_rows + n_bytes
            if chunk.has_dictionary_page or n_bytes > most_bytes or chunk.num_values > most_values:
                name = chunk.path_in_schema.partition(".")[0]
                raise ValueError(f"column {name} would take more memory than generated ones")


def damaged(path: Path, problem: str) -> RuntimeError:
    """Return the error that names a shard, what is wrong with it and what to do."""
    problem = " ".join(problem.split())
    return RuntimeError(
        f"{path} is damaged ({problem}): run the same `gelgap generate` again to repair it; "
        f"`gelgap inspect {path.parent} --verify` names all damage"
    )
