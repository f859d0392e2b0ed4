"""The columns of a domain: name, type, unit, meaning and how each is made. A new column is one entry here."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa

from gelgap.domains.picture_codec import encode_png
from gelgap.sim import Diagnostics, Pose

if TYPE_CHECKING:
    from gelgap.render import MembraneRenderer, Sensor
    from gelgap.sim import MembraneState

PICTURE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""A picture as Hugging Face `datasets` reads it."""
POINTS = pa.list_(pa.list_(pa.float32(), 2))

# 16-bit height maps: 0.1 µm steps from 0.5 mm outwards (the membrane bulges) to 6 mm inwards.
HEIGHT_MAP_STEP_MM = 1e-4
HEIGHT_MAP_OFFSET_MM = -0.5


@dataclass(frozen=True)
class LabelSource:
    """What the labels of one frame are made from: what was commanded, solved and measured."""

    frame: int
    pose: Pose
    trajectory: int
    step: int
    split: str
    state: "MembraneState"
    force_n: tuple[float, float, float]
    """What the force sensor reads; `state.force_n` is the true force."""


@dataclass(frozen=True)
class View:
    """One contact as a sensor sees it."""

    renderer: "MembraneRenderer"
    sensor: "Sensor"
    state: "MembraneState"

    @property
    def membrane(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The arguments by which a renderer takes the membrane: x, y and displacement, mm."""
        return self.state.x_mm, self.state.y_mm, self.state.displacement_mm


@dataclass(frozen=True)
class Column:
    """A column of the Parquet shards."""

    name: str
    type: pa.DataType
    unit: str
    meaning: str


@dataclass(frozen=True)
class LabelColumn(Column):
    """A column made from the contact alone; it has a value for every frame."""

    value: Callable[[LabelSource], Any]


@dataclass(frozen=True)
class ViewColumn(Column):
    """A column made by the renderer; null in frames without a picture."""

    cell: Callable[[View], Any]


def _height_map(view: View) -> dict[str, Any]:
    height_mm = view.renderer.height_map_mm(*view.membrane)
    codes = np.clip(np.rint((height_mm - HEIGHT_MAP_OFFSET_MM) / HEIGHT_MAP_STEP_MM), 0, 65535)
    return picture_cell(codes.astype(np.uint16))


def _contact_mask(view: View) -> dict[str, Any]:
    mask = view.renderer.contact_mask(*view.membrane, view.state.contact)
    return picture_cell(mask.astype(np.uint8) * 255)


def _marker_rest_mm(view: View) -> list[list[float]]:
    from gelgap.render import marker_rest_mm

    return _point_list(marker_rest_mm(view.sensor.markers))


def picture_cell(picture: np.ndarray) -> dict[str, Any]:
    """Return the value of a picture column."""
    return {"bytes": encode_png(picture), "path": None}


def _point_list(points: np.ndarray) -> list[list[float]]:
    return points.reshape(-1, 2).astype(np.float32).tolist()


_INT, _FLOAT = pa.int32(), pa.float64()

LABELS: tuple[LabelColumn, ...] = (
    LabelColumn("frame_id", _INT, "", "position on the path", lambda c: c.frame),
    LabelColumn("point_id", _INT, "", "number of the contact point", lambda c: c.pose.point_id),
    LabelColumn(
        "contact_class",
        _INT,
        "",
        "0 without contact; −1 off the paper's grid",
        lambda c: c.pose.contact_class,
    ),
    LabelColumn("depth_mm", _FLOAT, "mm", "commanded depth", lambda c: c.pose.depth_mm),
    LabelColumn("radius_mm", _FLOAT, "mm", "commanded travel sideways", lambda c: c.pose.radius_mm),
    LabelColumn(
        "angle_deg",
        _FLOAT,
        "°",
        "commanded direction of the travel; null without travel",
        lambda c: c.pose.angle_deg if c.pose.radius_mm else None,
    ),
    LabelColumn(
        "trajectory_id", _INT, "", "travel at one point, depth and direction", lambda c: c.trajectory
    ),
    LabelColumn("step", _INT, "", "place on the trajectory", lambda c: c.step),
    LabelColumn("x_mm", _FLOAT, "mm", "commanded contact point, to the right", lambda c: c.pose.point_x_mm),
    LabelColumn("y_mm", _FLOAT, "mm", "commanded contact point, down", lambda c: c.pose.point_y_mm),
    LabelColumn("commanded_z_mm", _FLOAT, "mm", "minus the depth", lambda c: -c.pose.depth_mm),
    LabelColumn("shear_x_mm", _FLOAT, "mm", "commanded travel along x", lambda c: c.pose.shear_x_mm),
    LabelColumn("shear_y_mm", _FLOAT, "mm", "commanded travel along y", lambda c: c.pose.shear_y_mm),
    LabelColumn("fx_n", _FLOAT, "N", "force of the indenter on the sensor", lambda c: c.force_n[0]),
    LabelColumn("fy_n", _FLOAT, "N", "force of the indenter on the sensor", lambda c: c.force_n[1]),
    LabelColumn("fz_n", _FLOAT, "N", "the same; ≤ 0 in compression", lambda c: c.force_n[2]),
    LabelColumn("converged", pa.bool_(), "", "false: no picture", lambda c: bool(c.state.converged)),
    LabelColumn(
        "contact_radius_mm",
        _FLOAT,
        "mm",
        "deformed radius where the normal pressure vanishes",
        lambda c: float(c.state.contact_radius_mm),
    ),
    LabelColumn("split", pa.string(), "", "train, validation or test", lambda c: c.split),
)
IMAGE = Column("image", PICTURE, "", "what the camera sees")

DIAGNOSTICS = tuple(
    LabelColumn(
        field.name,
        _INT if field.type is int else _FLOAT,
        "",
        "how the pose was solved",
        lambda c, name=field.name: getattr(c.state.diagnostics, name),
    )
    for field in dataclasses.fields(Diagnostics)
)
_VIEWS = (
    ViewColumn(
        "height_map",
        PICTURE,
        "mm",
        f"height towards the camera in mm is {HEIGHT_MAP_OFFSET_MM:g} + {HEIGHT_MAP_STEP_MM:g} × code",
        _height_map,
    ),
    ViewColumn(
        "contact_mask",
        PICTURE,
        "",
        "255 where the indenter touches",
        _contact_mask,
    ),
    ViewColumn(
        "marker_rest_mm",
        POINTS,
        "mm",
        "(x, y) of each dot on the undeformed membrane",
        _marker_rest_mm,
    ),
    ViewColumn(
        "marker_px",
        POINTS,
        "px",
        "(x, y) of each dot in the picture, pixel centres at +0.5",
        lambda view: _point_list(view.renderer.marker_px(*view.membrane)),
    ),
)
OPTIONAL: dict[str, tuple[Column, ...]] = {column.name: (column,) for column in _VIEWS} | {
    "diagnostics": DIAGNOSTICS
}
"""What a domain may also hold, by the names by which it is asked for."""
OptionalColumn = Literal["height_map", "contact_mask", "marker_rest_mm", "marker_px", "diagnostics"]
