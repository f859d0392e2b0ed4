"""Parquet shards: the columns of a domain with type, unit, meaning and how each is made, and shards as bytes.

A new column is one entry here.
"""

import dataclasses
import io
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gelgap.domains.domain import OptionalColumn
from gelgap.domains.formats.pictures import encode_png
from gelgap.sim import MembraneState, Pose
from gelgap.sim.estimate import Diagnostics

if TYPE_CHECKING:
    from gelgap.render import MembraneRenderer

SCHEMA_VERSION = 1
# A row group is what a reader must take from disk to see one frame: small, so that random access stays cheap.
ROWS_PER_GROUP = 32


class Kind(NamedTuple):
    """How a column's type is called: the feature of Hugging Face `datasets`, Croissant's type, its leaf in Parquet."""

    feature: dict[str, Any]
    croissant: str
    leaf: str = ""


_INT, _FLOAT, _BOOL, _TEXT = pa.int32(), pa.float64(), pa.bool_(), pa.string()
PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""A picture as Hugging Face `datasets` reads it."""
POINTS = pa.list_(pa.list_(pa.float32(), 2))
FORCES = pa.list_(pa.float32())
_NUMBER = {"dtype": "float32", "_type": "Value"}
_PAIR = {"feature": _NUMBER, "length": 2, "_type": "List"}
KINDS = {
    _INT: Kind({"dtype": "int32", "_type": "Value"}, "sc:Integer"),
    _FLOAT: Kind({"dtype": "float64", "_type": "Value"}, "sc:Float"),
    _BOOL: Kind({"dtype": "bool", "_type": "Value"}, "sc:Boolean"),
    _TEXT: Kind({"dtype": "string", "_type": "Value"}, "sc:Text"),
    PICTURE: Kind({"_type": "Image"}, "sc:ImageObject", "bytes"),
    POINTS: Kind({"feature": _PAIR, "_type": "List"}, "sc:Float", "list.element.list.element"),
    FORCES: Kind({"feature": _NUMBER, "_type": "List"}, "sc:Float", "list.element"),
}
"""Every type that a column may have."""

# 16-bit height maps: 0.1 µm steps from 0.5 mm outwards (the membrane bulges) to 6 mm inwards.
HEIGHT_MAP_STEP_MM = 1e-4
HEIGHT_MAP_OFFSET_MM = -0.5


class Contact(NamedTuple):
    """What the labels of one frame are made from; `force_n` is what the force sensor reads, the state's is true."""

    frame: int
    pose: Pose
    trajectory: int
    step: int
    split: str
    state: MembraneState
    force_n: tuple[float, ...]
    indenter: str


class View(NamedTuple):
    """One contact as a sensor sees it; `coarse_n` is its contact force by cells of the view, if that is wanted."""

    renderer: "MembraneRenderer"
    state: MembraneState
    coarse_n: np.ndarray | None = None

    @property
    def membrane(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The arguments by which a renderer takes the membrane: x, y and displacement, mm."""
        return self.state.x_mm, self.state.y_mm, self.state.displacement_mm


@dataclass(frozen=True)
class Column:
    """A column of the Parquet shards.

    A label has a `value` for every frame, made from the contact alone; other columns have a `cell`, made by the
    renderer, which is null in frames without a picture.
    """

    name: str
    type: pa.DataType
    unit: str
    meaning: str
    value: Callable[[Contact], Any] | None = None
    cell: Callable[[View], Any] | None = None


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


def _height_map(view: View) -> dict[str, Any]:
    return picture_cell(height_codes(view.renderer.height_map_mm(*view.membrane)))


def _contact_mask(view: View) -> dict[str, Any]:
    mask = view.renderer.contact_mask(*view.membrane, view.state.contact)
    return picture_cell(mask.astype(np.uint8) * 255)


def _marker_rest_mm(view: View) -> list[list[float]]:
    from gelgap.render import marker_rest_mm

    return _point_list(marker_rest_mm(view.renderer.sensor.markers))


def _marker_px(view: View) -> list[list[float]]:
    return _point_list(view.renderer.marker_px(*view.membrane))


def _traction(view: View) -> list[float] | None:
    return None if view.coarse_n is None else view.coarse_n.astype(np.float32).ravel().tolist()


def picture_cell(picture: np.ndarray) -> dict[str, Any]:
    """Return the value of a picture column."""
    return {"bytes": encode_png(picture), "path": None}


def _point_list(points: np.ndarray) -> list[list[float]]:
    return points.reshape(-1, 2).astype(np.float32).tolist()


_CLASS = "0 without contact; −1 off the paper's grid"
_DIRECTION = "commanded direction of the travel; null without travel"
_RADIUS = "deformed radius where the normal pressure vanishes"
HEIGHT_MAP_SCALE = (
    f"height towards the camera in mm is {HEIGHT_MAP_OFFSET_MM:g} + {HEIGHT_MAP_STEP_MM:g} × code"
)
_REST = "(x, y) of each dot on the undeformed membrane"
_SEEN = "(x, y) of each dot in the picture, pixel centres at +0.5"
_TORQUE = "torque of the indenter on the sensor about the contact point on the undeformed membrane"
_TURN = "commanded rotation vector of the indenter, along {}"
_TRACTION = "force (Fx, Fy, Fz) on each cell of 24 rows × 32 columns of the view; null without a picture"
LABELS = (
    Column("frame_id", _INT, "", "position on the path", lambda c: c.frame),
    Column("point_id", _INT, "", "number of the contact point", lambda c: c.pose.point_id),
    Column("contact_class", _INT, "", _CLASS, lambda c: c.pose.contact_class),
    Column("depth_mm", _FLOAT, "mm", "commanded depth", lambda c: c.pose.depth_mm),
    Column("radius_mm", _FLOAT, "mm", "commanded travel sideways", lambda c: c.pose.radius_mm),
    Column("angle_deg", _FLOAT, "°", _DIRECTION, lambda c: c.pose.angle_deg if c.pose.radius_mm else None),
    Column("trajectory_id", _INT, "", "travel at one point, depth and direction", lambda c: c.trajectory),
    Column("step", _INT, "", "place on the trajectory", lambda c: c.step),
    Column("x_mm", _FLOAT, "mm", "commanded contact point, to the right", lambda c: c.pose.point_x_mm),
    Column("y_mm", _FLOAT, "mm", "commanded contact point, down", lambda c: c.pose.point_y_mm),
    Column("commanded_z_mm", _FLOAT, "mm", "minus the depth", lambda c: -c.pose.depth_mm),
    Column("shear_x_mm", _FLOAT, "mm", "commanded travel along x", lambda c: c.pose.shear_x_mm),
    Column("shear_y_mm", _FLOAT, "mm", "commanded travel along y", lambda c: c.pose.shear_y_mm),
    Column("fx_n", _FLOAT, "N", "force of the indenter on the sensor", lambda c: c.force_n[0]),
    Column("fy_n", _FLOAT, "N", "force of the indenter on the sensor", lambda c: c.force_n[1]),
    Column("fz_n", _FLOAT, "N", "the same; ≤ 0 in compression", lambda c: c.force_n[2]),
    Column("converged", _BOOL, "", "false: no picture", lambda c: bool(c.state.converged)),
    Column("contact_radius_mm", _FLOAT, "mm", _RADIUS, lambda c: float(c.state.contact_radius_mm)),
    Column("split", _TEXT, "", "train, validation or test", lambda c: c.split),
)
IMAGE = Column("image", PICTURE, "", "what the camera sees")

OPTIONAL: dict[OptionalColumn, tuple[Column, ...]] = {
    "height_map": (Column("height_map", PICTURE, "mm", HEIGHT_MAP_SCALE, cell=_height_map),),
    "contact_mask": (
        Column("contact_mask", PICTURE, "", "255 where the indenter touches", cell=_contact_mask),
    ),
    "marker_rest_mm": (Column("marker_rest_mm", POINTS, "mm", _REST, cell=_marker_rest_mm),),
    "marker_px": (Column("marker_px", POINTS, "px", _SEEN, cell=_marker_px),),
    "diagnostics": tuple(
        Column(
            field.name,
            {int: _INT, bool: _BOOL}.get(field.type, _FLOAT),
            "",
            "how the pose was solved",
            lambda c, name=field.name: getattr(c.state.diagnostics, name),
        )
        for field in dataclasses.fields(Diagnostics)
    ),
    "indenter": (Column("indenter", _TEXT, "", "shape and size of the indenter", lambda c: c.indenter),),
    "torque": tuple(
        Column(f"t{axis}_n_mm", _FLOAT, "N mm", _TORQUE, lambda c, k=k: float(c.state.torque_n_mm[k]))
        for k, axis in enumerate("xyz")
    ),
    "traction": (Column("traction_n", FORCES, "N", _TRACTION, cell=_traction),),
    "turn": tuple(
        Column(name, _FLOAT, "°", _TURN.format(axis), lambda c, k=k: c.pose.turn_deg[k])
        for k, (name, axis) in enumerate(zip(("roll_x_deg", "roll_y_deg", "twist_deg"), "xyz", strict=True))
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
